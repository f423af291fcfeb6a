"""A loop whose base is found in a second, searches that ask for few effects, and studies that tests share.

A test that is about a page, a file or a chain of commands has no need of a long record or of the whole catalogue.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

from stictionid.effects import catalogue
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.selection.policy import Policy
from stictionid.typing import Progress
from stictionid.verbs.identify import Options, identify

MOVES = ((0.0, 3.0), (112.0, -4.0), (225.0, 5.0), (337.0, -3.0))
QUICK = Setting(Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0, scan_s=1.0), S=4.0, J=2.5, duration_s=450.0,
                setpoint_moves=MOVES, noise_sd=0.06)
# The same loop for the command `simulate`.
WORDS = ("--gain", 2, "--time-constant", 6, "--dead-time", 3, "--kc", 0.15, "--ti", 6, "--scan", 1, "--S", 4,
         "--J", 2.5, "--duration", 450, "--noise", 0.06, "--seed", 11,
         *(word for at, size in MOVES for word in ("--setpoint", f"{at:g}:{size:g}")))
# The base alone, its command known; without intervals where none is asserted.
HELD = Options(base_only=True, between="hold")
PLAIN = replace(HELD, intervals=False)

_known: dict[str, Study] = {}


def quick(seed: int = 11, **more: object) -> Loop:
    """The record of the quick loop, some of its settings changed."""
    return simulate(replace(QUICK, **more), seed=seed).loop


@contextmanager
def asked_only(*names: str) -> Iterator[None]:
    """Searches within ask for these effects of the catalogue alone, in two processes as in one."""
    def some() -> dict[str, object]:
        return {name: effect for name, effect in catalogue().items() if name in names}

    with mock.patch("stictionid.selection.node.catalogue", some):
        yield


def known(loop: Loop, *, options: Options | None = None, policy: Policy | None = None,
          progress: Progress | None = None) -> Study:
    """The study of a record, identified once in each worker for the same options."""
    options = options or Options()
    asked = pickle.dumps((loop, replace(options, command=""), policy))
    name = hashlib.sha256(asked).hexdigest()
    if name not in _known:
        _known[name] = identify(loop, options=options, policy=policy, progress=progress)
    return replace(_known[name], command=options.command)


@contextmanager
def identified_once() -> Iterator[None]:
    """Commands within identify a record that was identified before by its study: for tests of what follows."""
    with mock.patch("stictionid.verbs.identify.identify", known), \
            mock.patch("stictionid.verbs.diagnose.identify", known), \
            mock.patch("stictionid.verbs.agree.run_identify", known):
        yield
