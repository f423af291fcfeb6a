"""Numbers that steer the search over models, each with its unit and the benchmark that set it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ..errors import UsageError


def _number(default: Any, unit: str, meaning: str, benchmark: str) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "benchmark": benchmark})


_PLANTS, _CRITICISM = "benchmarks/plants", "CRITICISM.md section 7"


@dataclass(frozen=True, slots=True)
class Policy:
    """Numbers of the search over models; nothing else in this folder holds one."""

    budget: int = _number(1_500_000, "cost evaluations", "evaluations after which the search stops", _PLANTS)
    margin: float = _number(20.0, "BIC", "gain over the best noise model that names an effect", _PLANTS)
    structure_margin: float = _number(10.0, "BIC", "gain that changes the process, a lag or the command", _PLANTS)
    noise_margin: float = _number(20.0, "BIC", "gain that names a noise model", _PLANTS)
    walk_margin: float = _number(20.0, "BIC", "gain of a random walk over a stationary noise", _PLANTS)
    alike: float = _number(10.0, "BIC", "difference within which two models are equivalent", _CRITICISM)
    beam: int = _number(3, "nodes", "nodes expanded at one depth", _CRITICISM)
    depth: int = _number(4, "effects", "most effects beside a lag and a rest", _CRITICISM)
    finalists: int = _number(3, "nodes", "looks of an expansion that are fitted in full", _PLANTS)
    within: float = _number(150.0, "BIC", "distance from the best full fit that a look may have", _PLANTS)
    pairs: int = _number(6, "looks", "best looks whose pairs are looked at", _CRITICISM)
    better_base: float = _number(2.0, "2 log L", "gain by which a better optimum replaces a fit", _CRITICISM)
    blocks: int = _number(4, "blocks of 5", "held-out blocks in which the error must fall", _CRITICISM)
    block_gain: float = _number(0.005, "1", "least median fall of the held-out one-step error", _CRITICISM)
    free_run: float = _number(1.02, "1", "largest growth of the free-run error", _CRITICISM)
    at_noise: float = _number(1.1, "1", "free-run error over innovations that is the noise", _PLANTS)
    halved: float = _number(0.5, "1", "share of the free-run error that no chance leaves", _CRITICISM)
    neutral: float = _number(1e-3, "1", "distance from the neutral value at which an effect is absent", _PLANTS)
    edge: float = _number(0.01, "1", "distance from the neutral value at which a bound is allowed", _PLANTS)
    drift_alone: float = _number(0.05, "1", "share of its gain that a drift must have beyond a rest", _PLANTS)
    kick_samples: float = _number(3.0, "samples", "distance of a step from a setpoint kick", _PLANTS)
    look_alike: float = _number(0.35, "1", "difference of two outputs over the innovations that shows none", _PLANTS)
    rounding: float = _number(3.0, "1", "free-run error over noise and rounding that rounding explains", _PLANTS)
    long_record: int = _number(6000, "samples", "longest record that is searched whole", "benchmarks/search_race.py")


def read_policy(path: Path) -> Policy:
    """The policy of a TOML file; keys that are missing keep their defaults. Raises UsageError for an unknown key."""
    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"--policy {path}: {error}", "give a TOML file with lines such as: margin = 20.0") from None
    known = {f.name: f for f in fields(Policy)}
    for key, value in told.items():
        if key not in known:
            raise UsageError(f"--policy {path}: unknown key '{key}'", "known keys: " + ", ".join(known))
        whole = isinstance(known[key].default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)) or not value >= 0:
            raise UsageError(f"--policy {path}: {key} = {value!r} is no {'whole ' if whole else ''}number of 0 or more",
                             f"its default is {known[key].default:g}")
    return Policy(**told)
