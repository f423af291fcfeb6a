"""Checks of the options of an identification against the methods, laws and effects that exist."""

from __future__ import annotations

import numpy as np

from .. import laws as law_room
from ..effects import parse
from ..errors import UsageError
from ..options import ALL_LAWS, BETWEEN, TESTS, USUAL_SCAN_S, Options, searchable
from ..selection.policy import Policy
from . import get
from .contract import SPELLING, Method

_HIGHEST_ORDER = 6


def check_options(options: Options, policy: Policy | None = None) -> None:
    """Refuse options whose values do not exist or do not apply to their method; UsageError names those that do."""
    method = get(options.method)
    if options.between not in BETWEEN:
        raise UsageError(f"unknown way between samples '{options.between}'", "choose one of " + ", ".join(BETWEEN))
    if options.test is not None and options.test not in TESTS:
        raise UsageError(f"there is no test '{options.test}'", "give --test " + " or ".join(TESTS))
    if not (np.isfinite(options.scan_s) and options.scan_s > 0):
        raise UsageError(f"--scan {options.scan_s:g} s is not positive", "give the controller's scan, say 1")
    if options.order is not None and not 1 <= options.order <= _HIGHEST_ORDER:
        raise UsageError(f"--order {options.order} is outside 1 to {_HIGHEST_ORDER}", "give 1 or 2")
    if options.delay is not None and options.delay < 0:
        raise UsageError(f"--delay {options.delay} is negative", "give the dead time in samples, 0 or more")
    if options.law not in (None, ALL_LAWS) and not law_room.get(options.law).searchable:
        raise UsageError(f"the law '{options.law}' simulates only, it can't be searched",
                         "searchable: " + ", ".join(searchable()))
    for effect in options.effects:
        parse(effect)
    for name, value in options.fixed.items():
        if not np.isfinite(value) or (name != "gain" and value < 0) or (name == "gain" and value == 0):
            raise UsageError(f"--{name.removesuffix('_s').replace('_', '-')} {value:g} is out of range",
                             "give a positive number")
    _check_use(options, method, policy)


def _check_use(options: Options, method: Method, policy: Policy | None) -> None:
    """Refuse options that the method would ignore: they would look as if they had been used."""
    given = {
        "law": options.law is not None and options.law != method.law, "effects": bool(options.effects),
        "base_only": options.base_only, "between": options.between != "auto",
        "scan": options.scan_s != USUAL_SCAN_S, "fixed": bool(options.fixed),
        "order": options.order is not None, "delay": options.delay is not None,
        "policy": policy is not None, "test": options.test is not None,
    }
    for name in sorted(n for n, there in given.items() if there and n not in method.options):
        said = f"{SPELLING[name]} {options.law}" if name == "law" else SPELLING[name]
        extra = f" (its law is {method.law})" if name == "law" else ""
        does = ", ".join(SPELLING[n] for n in SPELLING if n in method.options) or "none of its own"
        raise UsageError(f"{said} has no meaning with --method {method.name}{extra}",
                         f"leave it out; options of {method.name}: {does}")
