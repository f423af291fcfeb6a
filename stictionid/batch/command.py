"""The command that reproduces one loop's study. The study stores it, and a resumed batch compares it."""

from __future__ import annotations

import hashlib
import shlex

from .. import effects, laws
from ..historian.bytes.options import FLAGS, KINDS, ReadOptions
from ..selection.policy import Policy
from .task import Work

# Hexadecimal digits of a fingerprint.
_DIGITS = 12


def command_for(path: str, work: Work, reading: ReadOptions) -> str:
    """`stictionid batch PATH` with every option that shapes the study, without those that only distribute the work.

    Fingerprints end it of what stands in files that may change: a policy's numbers, user-written effects and laws.
    """
    said = "stictionid batch " + shlex.join([path, *_work(work), *_reading(reading)])
    marks = [] if work.policy is None else [f"policy {_fingerprint(work.policy)}"]
    marks += [f"effect {name} {effect.sha256[:_DIGITS]}".rstrip() for name, effect in effects.added().items()]
    marks += [f"law {name} {law.sha256[:_DIGITS]}".rstrip() for name, law in laws.added().items()]
    return f"{said} # {', '.join(marks)}" if marks else said


def _fingerprint(policy: Policy) -> str:
    return hashlib.sha256(repr(policy).encode()).hexdigest()[:_DIGITS]


def _work(work: Work) -> list[str]:
    o = work.options
    said = ["--level", work.level]
    for flag, value, default in (("--method", o.method, "auto"), ("--law", o.law, None),
                                 ("--between", o.between, "auto"), ("--order", o.order, None),
                                 ("--delay", o.delay, None)):
        if value != default:
            said += [flag, str(value)]
    for effect in o.effects:
        said += ["--with", effect]
    for name, number in sorted(o.fixed.items()):
        said += ["--" + name.removesuffix("_s").replace("_", "-"), repr(number)]
    if work.policy_file:
        said += ["--policy", work.policy_file]
    if work.policy is not None and work.policy.budget != Policy().budget:
        said += ["--budget", str(work.policy.budget)]
    return said + ["--base-only"] * o.base_only + ["--no-intervals"] * (not o.intervals) + ["--seed", str(o.seed)]


def _reading(reading: ReadOptions) -> list[str]:
    said: list[str] = []
    for name, value in reading.said().items():
        flag, _, otherwise = FLAGS[name].partition("/")
        if isinstance(value, bool):
            said.append(flag if value else otherwise)
        elif isinstance(value, dict):
            for key, meaning in value.items():
                said += [flag, f"{key}={meaning}"]
        elif KINDS[name].startswith("tuple[float, float]"):
            said += [flag, ",".join(repr(v) for v in value)]
        elif isinstance(value, list):
            for item in value:
                said += [flag, str(item)]
        else:
            said += [flag, str(value)]
    return said
