"""Evidence of a verdict: the numbers of the comparison with a valve that does not stick, and the checks on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from .as_json.shape import beside


@dataclass(frozen=True, slots=True)
class Evidence:
    """Numbers behind a verdict; one that was not measured is null, and has no key in JSON.

    Errors of the quick fits are in the unit of y. Falls, shares and gains are shares (1). `likelihood_ratio` and
    `answered` are 2 log L. Friction lowers the one-step error in `blocks_won` of `blocks`, and in `held_out_won` of
    those held out; null where none could be held out. `answered` tells how clearly y answers the output. `code` names
    the precondition that a record fails. S above `S_excluded_above` is excluded. `looks_like` is another cause in
    words. `without_position` is the verdict by y alone, `capped_by` the code of the finding that forbids a sure one.
    S and J are those of a quick look. `further` holds the numbers of a method, and those of older versions.
    """

    rmse_without_friction: float | None = None
    rmse_with_friction: float | None = None
    share_of_pv_variance: float | None = None
    error_drop: float | None = None
    one_step_without: float | None = None
    one_step_with: float | None = None
    one_step_drop: float | None = None
    likelihood_ratio: float | None = None
    blocks_won: int | None = None
    blocks: int | None = None
    effects: tuple[str, ...] | None = None
    held_out_gain: float | None = field(default=None, metadata=beside("blocks"))
    held_out_won: int | None = field(default=None, metadata=beside("blocks"))
    answered: float | None = None
    code: str | None = None
    S_excluded_above: float | None = None
    looks_like: str | None = None
    without_position: str | None = None
    S: float | None = None
    J: float | None = None
    capped_by: str | None = None
    further: dict[str, Any] = field(default_factory=dict)

    @property
    def S_stated_above(self) -> float | None:
        """`S_excluded_above` of two digits, rounded up: no S of an interval that ends there is called excluded."""
        above = self.S_excluded_above
        if not above:
            return above
        unit = 10.0 ** (math.floor(math.log10(above)) - 1)
        return float(f"{math.ceil(above / unit - 1e-9) * unit:.2g}")


@dataclass(frozen=True, slots=True)
class Check:
    """One comparison that a verdict was decided by: its name, the number measured, the number needed, the outcome.

    `statistic` is null where nothing could be measured. Checks of friction pass from the threshold on; those of "no
    stiction" pass below it.
    """

    name: str
    statistic: float | None
    threshold: float
    passed: bool
