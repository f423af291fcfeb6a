"""Numbers of the search over models in one frozen dataclass, and the TOML file that changes them.

Each field holds its unit, its meaning and the benchmark that set it. Nothing else knows the names of the fields.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import DataError, UsageError
from ..system.files import text_of

_PLANTS, _METHOD, _LENGTH = "benchmarks/plants", "docs/details.md, section 11", "benchmarks/search_race.py"
_NOISE = "benchmarks/noise_family.py"

# Entries that earlier versions had, and what stands in their place.
_GONE = {"at_noise": "leave it out: slips of an integrator are placed in the likelihood along paths",
         "rounding": "leave it out: the likelihood along paths knows the error of a rounded output",
         "kick_samples": "leave it out: a step near a setpoint move meets the other gates",
         "drift_alone": "leave it out: a drift competes with a rest by its BIC",
         "blocks_better": "block_gain: blocks are compared held out alone"}


def _number(default: float, unit: str, meaning: str, benchmark: str, *, least: float = 0) -> Any:
    """A field with its default, unit, meaning, the benchmark that set it, and its least value."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "benchmark": benchmark, "least": least})


@dataclass(frozen=True, slots=True)
class Policy:
    """Numbers of one search; UsageError for a number below its least or not finite."""

    budget: int = _number(1_000_000, "cost evaluations", "evaluations after which the search stops", _PLANTS, least=1)
    margin: float = _number(20.0, "BIC", "gain beyond noise that names an effect", _PLANTS)
    structure_margin: float = _number(10.0, "BIC", "gain that changes process, lag, rest or command", _METHOD)
    noise_margin: float = _number(20.0, "BIC", "gain that names a noise model", _PLANTS)
    walk_margin: float = _number(2.0, "BIC", "gain of a random walk over stationary noise", _NOISE)
    alike: float = _number(10.0, "BIC", "distance within which models explain alike", _METHOD)
    beam: int = _number(3, "nodes", "nodes expanded at each depth", _METHOD, least=1)
    depth: int = _number(4, "effects", "most effects of a node, lag and rest not counted", _METHOD, least=1)
    finalists: int = _number(3, "nodes", "looks of an expansion that are fitted in full", _PLANTS, least=1)
    within: float = _number(150.0, "BIC", "distance from the best full fit that a look may have", _PLANTS)
    better_fit: float = _number(2.0, "2 log L", "gain by which a better optimum replaces a fit", _METHOD)
    better_base: float = _number(1.1, "1", "fall of the free run by which another base is expanded", _PLANTS)
    carried: float = _number(1.05, "1", "free run over innovations that noise alone makes", _PLANTS)
    block_gain: float = _number(0.005, "1", "least fall of the held-out one-step error", _METHOD)
    free_run: float = _number(1.02, "1", "growth of the free-run error that counts as none", _METHOD)
    neutral: float = _number(1e-3, "1", "distance from neutral, of the range, of an absent effect", _PLANTS)
    edge: float = _number(0.01, "1", "distance from neutral, of the range, where a limit is allowed", _PLANTS)
    endless_lag: float = _number(1.0, "periods", "time constant from which an integrator is asked for", _PLANTS)
    nearly: float = _number(1.3, "1", "free run over the noise, or over a model that explains, worth one more fit",
                            _PLANTS)
    freer: float = _number(1.3, "1", "fall of the free run that slips placed early or late do not make", _PLANTS)
    beyond_scans: float = _number(0.1, "1", "fall of the one-step error beyond unknown scans between samples", _PLANTS)
    chance: float = _number(0.01, "1", "chance of a false name, by bootstrap and by strokes", _METHOD,
                            least=0.001)
    periods: float = _number(12.0, "periods", "length of the record in which valves are searched", _PLANTS, least=1)
    valve_samples: int = _number(1_000, "samples", "least length of that record", _PLANTS, least=1)
    fit_samples: int = _number(4_000, "samples", "longest record on which looks and fits search", _LENGTH, least=1)
    unit: int = _number(2_000, "samples", "samples of one evaluation of the budget", _LENGTH, least=1)

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value, least, unit = getattr(self, f.name), f.metadata["least"], f.metadata["unit"]
            hint = f"give {least:g} {unit} or more: {f.metadata['meaning']}"
            # (A whole number of Python may be larger than any float.)
            if not (isinstance(value, int) or math.isfinite(value)):
                raise UsageError(f"{f.name} {value} is not a finite number", hint)
            if value < least:
                raise UsageError(f"{f.name} {value} is below {least:g}, the least ({unit})", hint)


def read_policy(path: str | Path) -> Policy:
    """The policy of a TOML file; a field that the file does not name keeps its default.

    UsageError for an absent file, one that is no TOML, an unknown key, and a value of the wrong type or out of range.
    """
    path = Path(path)
    hint = "write one entry a line, such as: budget = 50000"
    try:
        content = tomllib.loads(text_of(path, "policy", hint=hint))
    except DataError as error:
        raise UsageError(error.message, error.hint) from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"policy {path} is no TOML: {error}", hint) from None
    known = {f.name: f for f in dataclasses.fields(Policy)}
    for name in content:
        if name in _GONE:
            raise UsageError(f"policy {path} has the entry {name!r}, which is gone", _GONE[name])
        if name not in known:
            raise UsageError(f"policy {path} has an unknown entry {name!r}", f"known: {', '.join(sorted(known))}")
    try:
        values: dict[str, Any] = {name: _typed(known[name], value) for name, value in content.items()}
        return Policy(**values)
    except UsageError as error:
        raise UsageError(f"policy {path}: {error.message}", error.hint) from None


def with_budget(policy: Policy, budget: int) -> Policy:
    """The policy with another budget, in cost evaluations; UsageError where that is less than the least."""
    return replace(policy, budget=budget)


def _typed(known: dataclasses.Field[Any], value: object) -> float:
    """`value` as a number of the field's own type, by its default; a whole number also serves as a decimal one."""
    whole = isinstance(known.default, int)
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise UsageError(f"{known.name} is {value!r}, not a {'whole ' * whole}number",
                         f"give {known.metadata['meaning']} in {known.metadata['unit']}")
    try:
        return value if whole else float(value)
    except OverflowError:
        raise UsageError(f"{known.name} is larger than any number with decimals", "give a smaller one") from None
