"""Facts of a study: the verdict in one sentence, the main numbers, and the sections that every renderer prints.

Only this file and its two helpers (`wording` for digits, `sections` for the details) word and round the content of a
study. Terminal, markdown, HTML and JSON therefore cannot disagree.
"""

from __future__ import annotations

from itertools import pairwise

from ..fit.starts.beside_effect import RESTING
from ..record.intervals import Span
from ..record.study import Estimate, Study
from ..record.swing import BANDS, band
from ..system.plurals import counted
from . import effect_words, evidence, ranking, sections, story, test_plan, wording
from .document import Facts, KeyNumber, PageTable, Section

# A study of an older version may call a J known whose interval is wider than this share of its value.
WEAK_J_SHARE = 0.5

# S from the position differs where it is this share outside the interval of S.
DIFFERS = 0.1

_HEADINGS = {"stiction": "The valve sticks", "no stiction": "No stiction found", "undecided": "Undecided"}


def facts(study: Study, *, no_pictures: str = "") -> Facts:
    """All facts of one study in reading order; `no_pictures` says why there are none (data not found)."""
    findings = tuple(wording.sentence(f.statement) for step in study.steps[-1:] for f in step.findings)
    made = [section for section in (
        story.section(study), _size(study), sections.equivalents(study), _ladder(study),
        Section("no-pictures", "No pictures", (wording.sentence(no_pictures),)) if no_pictures else None,
        Section("trends", "Trends", bullets=findings, pictures=("trend",)),
        Section("valve", "Valve characteristic and phase plot", pictures=("characteristic", "phase")),
        None if study.cost_map is None else
        Section("map", "How sharply the record fixes S and J", pictures=("cost_map",)),
        Section("fit", "Model against measurement", pictures=("fit", "closeup", "acf", "spectrum"))
        if study.steps else None,
        ranking.section(study), sections.laws(study), sections.next_steps(study), test_plan.section(study),
        sections.oscillation(study), sections.data(study), sections.parameters(study), sections.method(study),
        sections.tree(study)) if section is not None]
    # The evidence stands behind the ladder that added the effects, or behind the size.
    at = next((i + 1 for i, s in enumerate(made) if s.key == "ladder"), 0)
    made[at:at] = evidence.sections(study)
    name = wording.name(study.data.name)
    return Facts(name, f"Valve stiction: {name}", study.verdict.stiction, *said(study), _reason(study),
                 _numbers(study), tuple(made))


def _reason(study: Study) -> str:
    """The reason of the verdict. Where it is older than the last effects, its numbers are marked as of that model."""
    reason = wording.sentence(study.verdict.reason)
    added = sections.added_later(study)
    judged = study.verdict.evidence.effects
    if not reason or not added or (judged is not None and set(judged) == set(study.steps[-1].effects)):
        return reason
    names = wording.listed([wording.name(s.added) for s in added])
    return (f"Before {names} {'was' if len(added) == 1 else 'were'} added: {wording.clean(study.verdict.reason)}. Now "
            f"the free-run error is {wording.number(study.steps[-1].error.best, 4)}.")


def adds(facts: Facts) -> bool:
    """True where the reason says more than the headline; that of an abstention does not."""
    said = " ".join((facts.headline, *facts.then)).casefold()
    return bool(facts.reason) and facts.reason[:-1].casefold() not in said


def said(study: Study) -> tuple[str, tuple[str, ...]]:
    """The headline and what follows it: what makes the loop swing, the state of the valve, what to do."""
    first, *then = filter(None, (story.cause(study), valve_state(study), jump_state(study), story.action(study)))
    return first, tuple(then)


def valve_state(study: Study) -> str:
    """The verdict in one sentence with the main number."""
    e = study.estimate
    word = _HEADINGS.get(study.verdict.stiction, wording.name(study.verdict.stiction))
    if e is None:
        word = "Can't tell from this record" if study.verdict.stiction == "undecided" else word
        return f"{word}: {_tail(study.verdict.reason)}"
    size = wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces)
    if study.verdict.stiction == "stiction":
        span = " of OP span" if e.unit == "%" else ""
        rough = " What the model misses may move S out of this range." if study.interval_caution else ""
        changed = story.valve_change(study)
        told = "" if changed is None else f" {wording.sentence(changed.statement)}"
        return f"{word}: S is {size}{span}{' now' * bool(told)}, {_band(e)}.{told}{rough}"
    if study.verdict.stiction == "no stiction":
        above = study.verdict.evidence.S_stated_above
        rest = (f"S above {wording.with_unit(above, e.unit, 2)} is excluded" if above is not None else
                f"with friction the best S would be {size}")
        return f"{word}: a model without friction does as well; {rest}."
    return f"{word}: S would be {size} ({_band(e)}), but this record does not prove that the valve sticks."


def _tail(reason: str) -> str:
    reason = wording.clean(reason).strip() or "no reason given"
    return reason if reason[-1] in ".!?" else reason + "."


def _band(e: Estimate) -> str:
    if e.unit != "%":
        return "no severity band, because the controller output is not in % of its span"
    return wording.severity_sentence(e.S, e.S_interval)


def _numbers(study: Study) -> tuple[KeyNumber, ...]:
    e, found = study.estimate, []
    if e is not None:
        level = f"{wording.number(100 * e.interval_level, 2)} % interval"
        found = [_key("S, stickband plus deadband", (e.S, e.S_interval, e.S_pieces), e.unit, level, _band(e)),
                 _jump_key(e, level)]
    if study.range.period_median_s is not None:
        found.append(KeyNumber("Oscillation period", wording.duration(study.range.period_median_s),
                               "oscillating" if study.range.oscillating else "not a regular oscillation"))
    found.append(KeyNumber("Confidence in the verdict", wording.number(study.verdict.confidence, 2), "0 to 1"))
    return tuple(found)


def _key(label: str, found: tuple[float, Span | None, wording.Pieces], unit: str, level: str,
         meaning: str) -> KeyNumber:
    """A headline number, found with its interval and the pieces of it, and its meaning."""
    shown, ends = wording.apart(*found)
    about = "no interval" if ends == wording.NOTHING else f"{ends}, {level}"
    return KeyNumber(label, f"{shown} {wording.name(unit)}".rstrip(), f"{about}; {meaning}")


def _jump_key(e: Estimate, level: str) -> KeyNumber:
    """J as a headline number; its range alone where the record leaves it open."""
    if not e.J_known:
        about = "no interval" if e.J_interval is None else level
        return KeyNumber("J, slip jump", wording.jump(e.J, e.J_interval, e.unit, known=False),
                         f"{about}; the record leaves more than half of J open")
    note = f"J/S {wording.number(e.J / e.S, 2) if e.S else wording.NOTHING}"
    if e.J_interval is not None and e.J_interval[1] - e.J_interval[0] > WEAK_J_SHARE * max(e.J, 1e-12):
        note = "weakly known: only J times the process gain is fixed"
    return _key("J, slip jump", (e.J, e.J_interval, e.J_pieces), e.unit, level, note)


def jump_state(study: Study) -> str:
    """The range of a J that is not known, the reason, and what would tell; empty where J is known."""
    e = study.estimate
    if e is None or study.verdict.stiction == "no stiction" or (e.J_known and not e.J_pieces):
        return ""
    span = wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=False)
    mine = set(study.steps[-1].effects) if study.steps else set()
    other = next((q for q in study.equivalents if set(q.effects) ^ mine == {RESTING}), None)
    if e.J_interval is None:
        return ""
    if other is not None:
        return f"J is {span}, by whether the valve rests: {wording.clean(other.what_would_tell)} would tell."
    return f"J is {span}: only J times the process gain is fixed. A setpoint move as large as PV's swing would tell."


def _size(study: Study) -> Section | None:
    e = study.estimate
    if e is None:
        return None
    S, J = (wording.apart(e.S, e.S_interval, e.S_pieces),
            wording.jump_apart(e.J, e.J_interval, e.J_pieces, known=e.J_known))
    rows = [("S, stickband plus deadband", *S, wording.name(e.unit), _band(e)),
            ("J, slip jump", *J, wording.name(e.unit), "")]
    percent = e.unit == "%"
    judged = "; the severity band is judged by the interval of S" if percent and e.S_interval else ""
    text = [f"Intervals hold {wording.number(100 * e.interval_level, 2)} % of the probability{judged}."
            if e.S_interval or e.J_interval else "S and J have no intervals."]
    text += [study.interval_caution] if study.interval_caution else []
    for label, value in (("f_s = (S+J)/2, static friction", (e.S + e.J) / 2),
                         ("f_d = (S-J)/2, kinetic friction", (e.S - e.J) / 2)) if e.J_known else ():
        rows.append((label, wording.number(value), wording.NOTHING, wording.name(e.unit), ""))
    if e.from_position is not None:
        p = e.from_position
        rows += [("S read from the measured position", wording.number(p.S), wording.NOTHING, wording.name(e.unit),
                  f"error of that fit {wording.number(p.rmse)}"),
                 ("J read from the measured position", wording.number(p.J), wording.NOTHING, wording.name(e.unit), "")]
        text.append("The measured valve position was not used for S and J above; it is the check on them.")
        text += position_sentences(study)
    if study.severity is not None:  # the damage that the friction does, not S alone
        text.append(wording.sentence(story.simulated(study.severity.statement)))
    if percent:
        bands = [f"{word} below {limit:g} %" for limit, word in BANDS[:-1]]
        text.append(f"Severity bands of S (no standard fixes them): {' · '.join(bands)} · {BANDS[-1][1]} from "
                    f"{BANDS[-2][0]:g} %.")
    table = PageTable("Size of the stiction", ("quantity", "value", "interval", "unit", "meaning"), tuple(rows), (1, 2))
    return Section("size", "How big it is", tuple(text), (), (table,))


def position_sentences(study: Study) -> list[str]:
    """The reason why S or J from the position may differ from S or J, where they do.

    The intervals of a model that misses something do not bound the difference, so its values stand for them.
    """
    e = study.estimate
    if e is None or e.from_position is None:
        return []
    p, found = e.from_position, []
    for name, value, span, seen in (("S", e.S, e.S_interval, p.S), ("J", e.J, e.J_interval, p.J)):
        low, high = span if span and not study.interval_caution else (value, value)
        small = study.verdict.stiction == "no stiction" and high >= seen  # both find no friction worth a number
        if not small and not (1.0 - DIFFERS) * low <= seen <= (1.0 + DIFFERS) * high:
            found.append(f"{name} from the position, {wording.with_unit(seen, e.unit)}, differs from {name}, "
                         f"{wording.with_unit(value, e.unit)}")
    return [f"{wording.listed(found)}: {_why_it_differs(study)}."] if found else []


def _why_it_differs(study: Study) -> str:
    """The likeliest reason for S and J from the position that are others than those of the model."""
    valve = [n for n in (study.steps[-1].effects if study.steps else ()) if effect_words.moves_valve(n)]
    if valve:
        return f"the position was fitted without {wording.listed([effect_words.noun(study, n) for n in valve])}"
    if study.adequate is False:
        return "both were fitted without what the model misses"
    return "the position signal may be filtered, scaled or only a demand, or the model may lack an effect"


def size(e: Estimate) -> str:
    """S and J with their intervals in one line."""
    level = wording.number(100 * e.interval_level, 2)
    J = wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=e.J_known)
    said = f"S {wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces)}, J {J}"
    return said + (f", {level} % intervals" if e.S_interval else ", no intervals")


def _ladder_rows(study: Study) -> tuple[tuple[str, ...], ...]:
    """One row per step: model, free-run error, change, held out, times the noise, one step ahead, fit, agreement."""
    rows = []
    before: float | None = None
    for step in study.steps:
        e = step.error
        label = "base model" if step.added is None else f"+ {wording.name(step.added)}{evidence.flag(step)}"
        change = wording.NOTHING if not before else f"{100 * (e.best / before - 1):+.0f} %"
        held = "extrapolates" if step.extrapolates else wording.number(e.rmse_holdout)
        rows.append((label, wording.number(e.best), change, held,
                     wording.times(e.best, e.noise_sd), wording.number(e.rmse_one_step),
                     wording.percent(e.fit_percent, 3), f"{step.restarts.agree} of {step.restarts.runs}"))
        before = e.best
    return tuple(rows)


def _ladder(study: Study) -> Section | None:
    if not study.steps:
        return None
    unit = _pv_unit(study)
    table = PageTable(f"Error after each step, in {unit}",
                  ("model", "error", "change", "held out", "x noise", "one step", "fit", "searches agree"),
                  _ladder_rows(study), tuple(range(1, 8)))
    text = [_ladder_sentence(study, unit)]
    if study.adequate is not None:
        word = "" if study.completed else "adequate: " if study.adequate else "not adequate: "
        text.append(f"The model is {word}{_tail(study.adequate_reason)}")
    text += path_sentences(study)
    text += [f"With {wording.name(b.added)} the free run errs more, {wording.number(b.error.best)} for "
             f"{wording.number(a.error.best)} without it." for a, b in pairwise(study.steps)
             if b.added and b.error.best > a.error.best]
    if study.missing:
        text.append("Effects named by the search: " + ", ".join(wording.name(m) for m in study.missing) + ".")
    if study.missing_reason:
        text.append(wording.sentence(study.missing_reason))
    text.append("Error is the free-run error of the model (RMS); held out means on stretches not used in the fit.")
    return Section("ladder", "Error ladder", tuple(text), (), (table,), ("ladder", "film"))


def path_sentences(study: Study) -> list[str]:
    """The share of slips that PV moved, and how much the break-away force scatters, in words; empty for none."""
    e, unit = study.steps[-1].error, _pv_unit(study)
    if e.rmse_path is None or e.slips_moved is None:
        return []
    text = [f"PV helped to place the slips: {100 * e.slips_moved:.0f} % come elsewhere than the law alone puts them. "
            f"With slips by OP alone the model errs by {wording.with_unit(e.rmse, unit)}."]
    scatter = study.estimate.scatter if study.estimate is not None else None
    if scatter is not None and scatter.interval is not None:
        low, high = scatter.interval
        text.append(f"From stroke to stroke the break-away force scatters by {wording.number(scatter.value)} "
                    f"{wording.name(scatter.unit)} (90 %: {wording.number(low)} to {wording.number(high)}), "
                    f"{100 * scatter.share_of_S:.1f} % of S." if low > 0.0 else
                    f"From stroke to stroke the break-away force scatters by less than {wording.number(high)} "
                    f"{wording.name(scatter.unit)}.")
    return text


def _ladder_sentence(study: Study, unit: str) -> str:
    first, last = study.steps[0].error, study.steps[-1].error
    moved = f"The free-run error is {wording.with_unit(last.best, unit)}"
    if len(study.steps) > 1:
        moved = (f"The free-run error went from {wording.with_unit(first.best, unit)} to "
                 f"{wording.with_unit(last.best, unit)} with "
                 f"{counted(len(study.steps) - 1, 'added effect')}")
    if not last.noise_sd:
        return moved + "."
    return (f"{moved}, {wording.times(last.best, last.noise_sd)} times the irreducible noise "
            f"{wording.with_unit(last.noise_sd, unit)}.")


def _pv_unit(study: Study) -> str:
    return wording.name(study.data.units.get("process_value") or "units of PV")


def comparison(studies: list[Study]) -> PageTable:
    """One row per study, for a report that holds several."""
    rows = []
    for study in studies:
        e, last = study.estimate, study.steps[-1].error if study.steps else None
        ratio = wording.times(last.best, last.noise_sd) if last else wording.NOTHING
        rows.append((
            wording.name(study.data.name), wording.name(study.verdict.stiction),
            wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces) if e else wording.NOTHING,
            band(e.S) if e and e.unit == "%" else wording.NOTHING,
            wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=e.J_known) if e else wording.NOTHING,
            f"{wording.number(study.range.period_median_s)} s" if study.range.period_median_s else wording.NOTHING,
            ratio, {None: wording.NOTHING, True: "yes", False: "no"}[study.adequate]))
    return PageTable("Loops compared", ("loop", "verdict", "S", "severity", "J", "period", "x noise", "adequate"),
                 tuple(rows), (2, 4, 5, 6))
