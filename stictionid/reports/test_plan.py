"""The planned test in words: its steps, its limits, the answers it tells apart, and what would do instead."""

from __future__ import annotations

from ..record.planned_test import PlannedTest, ValveAnswer
from ..record.study import Study
from . import wording
from .document import Section


def section(study: Study) -> Section | None:
    """The test that would settle an open answer; None where no answer is open."""
    said = sentences(study)
    return Section("test", "The test that would settle it", said) if said else None


def sentences(study: Study) -> tuple[str, ...]:
    """The planned test, one claim a sentence; empty where there is none."""
    plan = study.planned_test
    if plan is None:
        return ()
    op, pv = study.estimate.unit if study.estimate else "%", study.data.units.get("process_value") or "units of PV"
    text = [*(_steps(plan, study, op, pv) if plan.moves else [f"No manual test settles it: {plan.reason}."])]
    for key, option, name, limits, unit in (("op", "--op-limits", "OP", plan.op_limits, op),
                                            ("pv", "--pv-limits", "PV", plan.pv_limits, pv)):
        shown = f"{limits[0]:.4g} to {limits[1]:.4g} {wording.name(unit)}"
        text.append(f"No limits of {name} given: {shown} assumed; pass {option} LO,HI." if key in plan.assumed else
                    f"Limits of {name}: {shown}.")
    return (*text, f"Where no test is possible, this would do: {plan.otherwise}.") if plan.otherwise else tuple(text)


def _steps(plan: PlannedTest, study: Study, op: str, pv: str) -> list[str]:
    op, pv = wording.name(op), wording.name(pv)
    loop = "the loop" if study.data.name == "loop" else wording.name(study.data.name)
    steps = ", ".join(f"{move:+.4g}" for move in plan.moves)
    first, *others = (_answer(a, op) for a in plan.answers)
    return [
        f"Put {loop} in manual at {plan.start:g} {op}, wait {plan.hold_s:g} s, then step OP {steps} {op}, a step every "
        f"{plan.hold_s:g} s: {wording.duration(plan.duration_s)} in all.",
        f"PV moves by at most {wording.number(plan.pv_change)} {pv}, whichever answer is true.",
        f"Record OP and PV every {study.data.step_s:g} s or faster.",
        "Then run: stictionid identify test.csv --test steps",
        f"The test tells {first} from {wording.listed(others)}: the expected likelihood ratio is "
        f"{wording.number(plan.likelihood_ratio)}, {plan.needed:g} are needed.",
        "A person must run it: this program moves no valve."]


def _answer(answer: ValveAnswer, unit: str) -> str:
    if answer.S == 0.0:
        return "a valve that follows OP"
    return f"a valve with S {wording.number(answer.S)} and J {wording.number(answer.J)} {unit}"
