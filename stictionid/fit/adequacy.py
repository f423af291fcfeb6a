"""Irreducible noise of a study, and the judgement of its models against it: one number for all steps.

The free linear model of a step and its one-step error bound the noise from above. The least of all bounds is the best
estimate. A step that the record does not support bounds nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..effects import noises_in, parse
from ..numerics.autoregression import irreducible_error
from ..process.rounded import drawn_lines, is_coarse, thinned_output, unknown_step
from ..record.loop import RESOLVED, Finding, Loop
from ..record.study import BUT_FOR, Step
from ..typing import BoolArray, FloatArray

# Free-run error within this factor of the irreducible noise is adequate (docs/details.md, section 10.1).
ADEQUATE = 1.05
# Above this multiple of the irreducible noise the intervals are reported as conditional on the model.
# A model explains a record on its own as long as PV moved at most this share of its slips.
MOST_MOVED = 0.25
CONDITIONAL, _CONDITIONAL = "intervals-conditional", 2.0

NO_FLOOR = ("the record is too short, or PV is missing in too many places without a rule, to estimate its irreducible "
            "noise")
# A noise that carries what a model leaves, in words, by the kind of its effect.
_CARRIERS = {"autoregressive": "coloured noise", "random-walk": "a random walk", "resonant": "a narrow band",
             "load": "disturbances of the load"}
# The same where u and y can't tell at which end of the process they enter; the code of the finding that says so.
LOAD_OR_OUTPUT, NOISE_MODEL = "disturbances of the load or the output", "noise-model"


def noise_floor(loop: Loop, position: FloatArray, good: BoolArray, dead_time_s: float,
                disturbance: FloatArray | None = None) -> float | None:
    """Irreducible noise in the unit of y for a valve position (n,) at the samples that count, less a known disturbance.

    None where the record is too short. What a historian drew between two values stands in the past of those it kept.
    """
    y, nearest = drawn_lines(loop)
    known = good if nearest == 1 else loop.driven
    y = np.where(known, y, 0.0) - (0.0 if disturbance is None else disturbance)
    return irreducible_error(y, position, good, int(dead_time_s / loop.step_s), loop.starts, nearest, known)


def with_one_noise(steps: Iterable[Step], loop: Loop, *others: float) -> tuple[Step, ...]:
    """The steps with the irreducible noise of their study, and with the caution on intervals that it asks for.

    `others` are one-step errors of models that are no step of the study. An error that no transmitter of the loop
    resolves asks for none.
    """
    steps = tuple(steps)
    free = [s.error.noise_sd for s in steps if s.error.noise_sd is not None]
    ahead = [s.error.rmse_one_step for s in steps if s.supported is not False and s.error.rmse_one_step]
    if not free:
        return steps
    noise = min([*free, *ahead, *others])
    return tuple(_move_caution(replace(s, error=replace(s.error, noise_sd=noise)), loop.resolution) for s in steps)


def _move_caution(step: Step, resolution: float) -> Step:
    """A step whose finding on conditional intervals is that of its own error, if that exceeds the resolution of y."""
    others = tuple(f for f in step.findings if f.code != CONDITIONAL)
    error, noise = step.error.best, step.error.noise_sd
    has_intervals = any(p.name == "S" and p.interval is not None for p in step.parameters)
    if not has_intervals or not noise or error <= max(_CONDITIONAL * noise, resolution) or carrier(step):
        return replace(step, findings=others)
    said = Finding(
        CONDITIONAL, "warning",
        f"the intervals take the model for right, but its free-run error {error:.4g} is {error / noise:.3g} times the "
        f"irreducible noise {noise:.4g}: S and J may lie outside (stictionid diagnose looks for what is missing, "
        "stictionid agree FILE --windows 3 shows how far they move along the record)",
        {"rmse": error, "noise_sd": noise}, (), "docs/details.md, section 8")
    return replace(step, findings=(*others, said))


def carrier(step: Step) -> str:
    """The named noise that carries what a step's model leaves, in words; empty where none does.

    Its one-step error is then the irreducible noise. Differences of y under a noise model carry a drift.
    """
    if by_pv := _by_pv(step):
        return by_pv
    noise, ahead = step.error.noise_sd, step.error.rmse_one_step
    if noise is None or ahead is None or ahead > ADEQUATE * noise:
        return ""
    named = noises_in(step.effects)
    if named:
        if any(f.evidence.get("alike") for f in step.findings if f.code == NOISE_MODEL):
            return LOAD_OR_OUTPUT
        return _CARRIERS[parse(named[-1])[0].noise or ""]
    return "a drift" if step.model.get("taps") and step.model.get("increments") else ""


def _by_pv(step: Step) -> str:
    """The slips that carry what a step's model leaves, in words; empty where PV moved none, or few."""
    e = step.error
    carried = e.unavoidable is not None and e.best <= ADEQUATE * e.unavoidable and (e.slips_moved or 0.0) > MOST_MOVED
    return "slips that PV moved" if carried else ""


def said_rounding(loop: Loop) -> str:
    """Words on the digits of an output that no law of its controller gives back."""
    unit, step = loop.unit("output", "%"), unknown_step(loop)
    known = f"recorded in steps of {step:.4g} {unit}" if thinned_output(loop) is None else \
        f"known to within {0.5 * step:.4g} {unit}, because the historian thinned it"
    return (f"the output is {known}, and no P, PI or PID law of these samples gives its digits back: S and J may lie "
            "further off than their intervals say; export the output as the controller gave it")


def judge_adequacy(step: Step, loop: Loop) -> tuple[bool, str]:
    """True where the step's free-run error is the irreducible noise, and the sentence that says so.

    A rounding of the record's output that was not undone is said first.
    """
    holds, why = _beside_noise(step, loop.resolution)
    values = step.model.get("values", {})
    return holds, (f"{said_rounding(loop)}; {why}" if "S" in values and is_coarse(loop, values["S"]) else why)


def unknown_output(step: Step) -> str:
    """The part of the output that a step's slips do not know, in words: its moves between samples, or its digits."""
    return "moves of the output between the samples" if step.model.get("paths", {}).get("jitter") else \
        "digits of the output"


def placed_slips_words(step: Step) -> str:
    """Words on the slips of a step where PV helped to place them; empty where the law alone did."""
    share = step.error.slips_moved
    return "" if share is None else f" with slips where PV places them ({100 * share:.0f} % moved)"


def _beside_noise(step: Step, resolution: float) -> tuple[bool, str]:
    noise, error, least = step.error.noise_sd, step.error.best, step.error.unavoidable
    if error <= resolution and not _by_pv(step):
        return True, (f"the free-run error {error:.4g} is less than {100 * RESOLVED:g} % of the swing of PV: "
                      "no transmitter resolves it")
    if noise is None or least is None:
        return False, NO_FLOOR
    said = f"the free-run error {error:.4g}{placed_slips_words(step)}"
    if error <= ADEQUATE * least:
        floor = f"the irreducible noise {noise:.4g}"
        if error > ADEQUATE * noise:
            floor = f"{least:.4g}, {floor} together with unknown {unknown_output(step)}"
        near = f"{said} is within {100 * (ADEQUATE - 1):.0f} % of {floor}"
        if carried := _by_pv(step):
            return False, f"{BUT_FOR} {carried}: {near}; a model of its own moves at most {100 * MOST_MOVED:.0f} %"
        return True, f"{near}: nothing is left to explain"
    times = f"{said} is {error / noise:.3g} times the irreducible noise {noise:.4g}"
    if carried := carrier(step):
        return False, f"{BUT_FOR} {carried}: {times}, and the noise model carries what is left, which may be physics"
    return False, f"{times}: something is missing"
