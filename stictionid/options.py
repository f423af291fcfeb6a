"""Options of an identification, and the checks of them that need the record."""

from __future__ import annotations

from dataclasses import dataclass, field

from . import laws as law_room
from .effects import parse
from .errors import UsageError
from .record.loop import Finding, Loop

BETWEEN = ("auto", "hold", "corner", "decimated")
# Scan of a usual controller, where none is given. Unit: s.
USUAL_SCAN_S = 1.0
# Order of the polynomials of a difference equation, where none is given.
USUAL_ORDER = 2
# Manual tests that a record may be.
TESTS = ("steps",)
# The word that asks for every law that can be searched.
ALL_LAWS = "all"


@dataclass(frozen=True, slots=True)
class Options:
    """Options of one identification; the command's help explains them.

    `fixed` may hold gain, time_constant_s and dead_time_s. `law` and `order` None mean the method's own. `scan_s` is
    the scan of the controller, for an export slower than that. `notes` are findings made before the search (a step
    test, say) that the study keeps. `test` is one of TESTS for a record of a manual test. Without `intervals` the study
    has none, and the work for them is left out.
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
    test: str | None = None
    intervals: bool = True

    def check_record(self, loop: Loop) -> None:
        """Refuse effects that need tags the record lacks, and a dead time of more than half the record.

        With so long a dead time nothing could be seen of the valve.
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


def check_tag(effect: str, loop: Loop) -> None:
    """UsageError for an effect of a tag that the record does not have, or that is constant, or of a number not given.
    """
    found, tag = parse(effect)
    if "value" in found.needs and not tag:
        raise UsageError(f"{found.name} is held at a number that is known", f"write {found.name}:1.5, for example")
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
