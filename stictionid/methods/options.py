"""How to identify: the options of `identify`, and which of them do not exist or do not apply."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .. import laws as law_room
from ..effects import parse
from ..errors import UsageError
from ..loop import Finding, Loop
from . import get
from .contract import SPELLING, Method

BETWEEN = ("auto", "hold", "corner", "decimated")
# Scan of a usual controller, where none is given. Unit: s.
USUAL_SCAN_S = 1.0
# The word that asks for every law that can be searched.
ALL_LAWS = "all"
_HIGHEST_ORDER = 6


@dataclass(frozen=True, slots=True)
class Options:
    """How to identify; see the command's help. `fixed` may hold gain, time_constant_s and dead_time_s.

    `law` and `order` None mean the method's own; `scan_s` is the scan of the controller, for an export slower than
    that. `notes` are findings made before the search (a step test, say) that the study shall remember.
    """

    method: str = "auto"
    law: str | None = None
    effects: tuple[str, ...] = ()
    base_only: bool = False
    between: str = "auto"
    fixed: dict[str, float] = field(default_factory=dict)
    seed: int = 0
    order: int | None = None
    delay: int | None = None
    command: str = ""
    notes: tuple[Finding, ...] = ()
    scan_s: float = USUAL_SCAN_S

    def check(self) -> None:
        """Refuse values that do not exist or do not apply to the method, naming those that do."""
        method = get(self.method)
        if self.between not in BETWEEN:
            raise UsageError(f"unknown way between samples '{self.between}'", "choose one of " + ", ".join(BETWEEN))
        if not (np.isfinite(self.scan_s) and self.scan_s > 0):
            raise UsageError(f"--scan {self.scan_s:g} s is not positive", "give the controller's scan, say 1")
        if self.order is not None and not 1 <= self.order <= _HIGHEST_ORDER:
            raise UsageError(f"--order {self.order} is outside 1 to {_HIGHEST_ORDER}", "give 1 or 2")
        if self.delay is not None and self.delay < 0:
            raise UsageError(f"--delay {self.delay} is negative", "give the dead time in samples, 0 or more")
        if self.law not in (None, ALL_LAWS) and not law_room.get(self.law).searchable:
            raise UsageError(f"the law '{self.law}' simulates only, it can't be searched",
                             "searchable: " + ", ".join(searchable()))
        for effect in self.effects:
            parse(effect)
        for name, value in self.fixed.items():
            if not np.isfinite(value) or (name != "gain" and value < 0) or (name == "gain" and value == 0):
                raise UsageError(f"--{name.removesuffix('_s').replace('_', '-')} {value:g} is out of range",
                                 "give a positive number")
        self._check_use(method)

    def check_record(self, loop: Loop) -> None:
        """Refuse effects that need tags the record lacks, and a dead time of more than half of it.

        Of so long a dead time nothing could be seen of the valve.
        """
        for effect in self.effects:
            check_tag(effect, loop)
        most = loop.samples // 2
        given = {"--delay": (self.delay, most, "samples"),
                 "--dead-time": (self.fixed.get("dead_time_s"), most * loop.step_s, "s")}
        for option, (value, limit, unit) in given.items():
            if value is not None and value > limit:
                raise UsageError(f"{option} {value:g} is more than half the record ({limit:g} {unit})",
                                 f"give {limit:g} {unit} or less, or leave {option} out")

    def _check_use(self, method: Method) -> None:
        """Refuse options the method would only ignore: they would look as if they had been used."""
        given = {
            "law": self.law is not None and self.law != method.law, "effects": bool(self.effects),
            "base_only": self.base_only, "between": self.between != "auto",
            "scan": self.scan_s != USUAL_SCAN_S, "fixed": bool(self.fixed),
            "order": self.order is not None, "delay": self.delay is not None,
        }
        for name in sorted(n for n, there in given.items() if there and n not in method.options):
            said = f"{SPELLING[name]} {self.law}" if name == "law" else SPELLING[name]
            extra = f" (its law is {method.law})" if name == "law" else ""
            does = ", ".join(SPELLING[n] for n in SPELLING if n in method.options) or "none of its own"
            raise UsageError(f"{said} has no meaning with --method {method.name}{extra}",
                             f"leave it out; options of {method.name}: {does}")


def check_tag(effect: str, loop: Loop) -> None:
    """UsageError for an effect of a further tag that the record does not have, or that rests throughout."""
    found, tag = parse(effect)
    if "extra" not in found.needs:
        return
    if tag and tag not in loop.extras:
        raise UsageError(f"the record has no further tag '{tag}'", "its further tags: "
                         + (", ".join(loop.extras) or "none; read it with --extra TAG"))
    if not loop.extras:
        raise UsageError(f"{found.name} needs a further tag of the export", "read it with --extra TAG")
    if not loop.moving_extras or (tag and tag not in loop.moving_extras):
        raise UsageError(f"the further tag '{tag or ', '.join(loop.extras)}' does not vary, so it can't disturb "
                         "anything", "name one that moves with --extra TAG")


def searchable() -> tuple[str, ...]:
    """Names of the laws that can be searched, the default first."""
    return tuple(name for name, law in law_room.catalogue().items() if law.searchable)
