"""Studies of short loops, compared with those of an unchanged package: python benchmarks/short_studies.py FILE.

The first run writes the studies of `identify` and `diagnose --apply` into FILE. A later run compares its own with them
and ends at the first loop whose study differs in any number or word: exit 1. `mutants.py` asks so whether a fault that
no test finds changes an answer.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

# A controller that moves the output between the samples, and an integrator with its own.
MOVING = {"controller": (0.15, 6.0)}
TANK = {"plant": (0.02, 4.0, 3.0, True), "controller": (1.5, 80.0, 1.0)}
# Hidden effects of a loop, changes of its setting, samples of which one is kept, options of the search, and the effects
# that it asks for: all where none is named. The quickest loops come first.
LOOPS: tuple[tuple[tuple[str, ...], dict[str, Any], int, dict[str, Any], tuple[str, ...]], ...] = (
    (("step-disturbance",), {}, 1, {"bootstrap": 3, "apply": False}, ("step-disturbance", "extra-lag")),
    (("coloured-noise",), {}, 1, {}, ()),
    (("extra-lag",), {}, 1, {"everything": True}, ("travel-limit", "re-sticking", "extra-lag")),
    (("re-sticking",), MOVING, 1, {"intervals": True}, ()),
    (("measured-disturbance",), {}, 1, {}, ()),
    (("step-disturbance",), TANK, 1, {}, ("step-disturbance", "ramp-disturbance", "re-sticking")),
    (("sinusoidal-disturbance",), MOVING, 1, {}, ()),
    (("extra-lag", "step-disturbance"), {}, 1, {}, ()),
    (("re-sticking",), {"duration_s": 1200.0}, 4, {"budget": 20_000}, ("re-sticking",)),
    (("slip-overshoot",), {"duration_s": 900.0}, 1, {}, ()),
)


def studies() -> Iterator[str]:
    """The study of each loop as text, one after the other."""
    from loops_with_effects import small
    from quick_loops import asked_only

    from stictionid.effects import catalogue
    from stictionid.model.closed_loop import Controller, Plant
    from stictionid.record.study import to_json
    from stictionid.selection.policy import Policy
    from stictionid.verbs.diagnose import diagnose
    from stictionid.verbs.identify import Options, identify

    made = {"plant": Plant, "controller": Controller}
    for hidden, changes, keep, options, names in LOOPS:
        more = {n: made[n](*v) if n in made else v for n, v in ({"duration_s": 600.0} | changes).items()}
        loop = small(*hidden, **more)[1]
        loop = replace(loop, position=None, step_s=loop.step_s * keep, **{
            n: getattr(loop, n)[::keep] for n in ("output", "process_value", "setpoint", "used")},
            extras={n: tag[::keep] for n, tag in loop.extras.items()})
        policy = Policy(budget=options.get("budget", Policy().budget))
        with asked_only(*(names or catalogue())):
            study = identify(loop, options=Options(intervals=options.get("intervals", False)), policy=policy)
            if study.estimate is not None:
                rest = {n: v for n, v in options.items() if n not in ("budget", "intervals")}
                study = diagnose(loop, study, policy=policy, **({"apply": True} | rest))
        yield to_json(study)


def main() -> int:
    """Write the studies, or compare them; 1 at the first that differs."""
    path = Path(sys.argv[1])
    if not path.exists():
        path.write_text(json.dumps([*studies()]), encoding="utf-8")
        return 0
    before = json.loads(path.read_text(encoding="utf-8"))
    for (hidden, *_), text, known in zip(LOOPS, studies(), before, strict=True):
        if text != known:
            print(f"{' + '.join(hidden)}: another study")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
