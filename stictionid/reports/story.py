"""The story of a loop in three sentences: what makes it swing, the state of its valve, and what to do.

The first follows from the run with a perfect valve, because in a closed loop the parts of PV go together.
"""

from __future__ import annotations

from ..record.loop import Finding
from ..record.study import VALVE_CHANGED, Study
from ..record.swing import Share, Swing
from . import effect_words, wording
from .document import PageTable, Section

# Shares below this are left out of sentences, and causes from the second on call for an action. Unit: 1.
_SHOWN, _ACTED_ON = 0.01, 0.1
# Share of the variance of PV that a model must explain before it names a cause without a doubt in front. Unit: 1.
_EXPLAINS = 0.5


def cause(study: Study) -> str:
    """The causes of the swing, what a perfect valve would leave, and what else is in the last model; empty where none
    is known."""
    rest = [effect_words.noun(study, name) for name in _beside_causes(study, _SHOWN)]
    return " ".join(filter(None, (_swing(study), f"Also in the model: {wording.listed(rest)}." if rest else "")))


def _beside_causes(study: Study, least: float) -> list[str]:
    """Names of the effects of the last model whose share of the swing is below the `least`, or has no number."""
    causes = study.swing.causes if study.swing is not None else ()
    named = {effect_words.plain(s.part) for s in causes if abs(s.share) >= least}
    return [n for n in effect_words.of_model(study) if effect_words.plain(n) not in named]


def _swing(study: Study) -> str:
    """The causes of the swing in one sentence, and what a perfect valve would leave; empty where they are not known."""
    swing = study.swing
    if swing is None or study.estimate is None:
        return ""
    what = "makes the loop swing" if study.range.oscillating else "moves PV"
    explained = _explained(study)
    if not swing.causes:
        why, mark, rest = swing.reason.replace("not told: ", "not simulated: ", 1).partition("not simulated: ")
        said = wording.sentence(f"What {what} can't be told from this record: "
                                f"{rest.replace('no setpoint', 'it holds no setpoint')}" if mark else
                                f"What {what}: {wording.clean(why)}")
        return said + ("" if explained is None else f" The model explains {_percent(explained)} of PV and "
                                                           "still misses something.")
    shown = sorted((s for s in swing.causes if abs(s.share) >= _SHOWN), key=lambda s: -s.share)
    said = wording.listed([f"{share} {effect_words.part(study, s.part)}"
                           for s, share in zip(shown, shares(shown), strict=True)])
    perfect = _perfect_valve(study, swing)
    told = f"What {what} about its setpoint: {said}. {perfect}"
    if explained is None:
        return told
    if explained < _EXPLAINS:
        return (f"What {what} is not proven, because the model explains only {_percent(explained)} of PV. By this "
                f"model, about the setpoint: {said}. {perfect}")
    return (f"{told} These shares are rough: the model explains {_percent(explained)} of PV and still misses "
            "something.")


def simulated(reason: str) -> str:
    """A reason or an outcome of the run with a perfect valve, with its subject where that run is missing."""
    said = wording.clean(reason).removeprefix("not told: ")
    return said.replace("not simulated", "the loop with a perfect valve was not simulated", 1)


def _percent(share: float) -> str:
    """A share in whole per cent; that of a model that misses something never reads as all."""
    return "more than 99 %" if share > 0.99 else f"{100 * share:.0f} %"


def _explained(study: Study) -> float | None:
    """Share of the variance of PV that the last model explains; None where it is adequate, or nobody has judged it."""
    fit = study.steps[-1].error.fit_percent if study.steps else None
    if study.adequate is not False or study.completed or fit is None:
        return None
    return max(1.0 - (1.0 - fit / 100.0) ** 2, 0.0)


def _perfect_valve(study: Study, swing: Swing) -> str:
    """The fate of the swing with a perfect valve."""
    unit = wording.name(study.data.units.get("process_value") or "units of PV")
    change = (f"PV would scatter about its setpoint by {wording.number(swing.sd_perfect)} instead of "
              f"{wording.with_unit(swing.sd, unit)}")
    how = {True: "the swing would go on", False: "the swing would end", None: "part of the swing would go on"}
    return f"With a perfect valve {how[swing.goes_on]}: {change}."


def shares(of: list[Share]) -> list[str]:
    """Shares in whole per cent that add up like the exact ones (largest remainders get the rest)."""
    exact = [100.0 * s.share for s in of]
    whole = [int(e // 1) for e in exact]
    for k in sorted(range(len(of)), key=lambda k: whole[k] - exact[k])[:round(sum(exact)) - sum(whole)]:
        whole[k] += 1
    return [f"{w} %" for w in whole]


def action(study: Study) -> str:
    """The action for each cause that is worth one, the largest first; empty where nothing is known."""
    swing = study.swing
    if swing is None or study.estimate is None:
        return ""
    others = [effect_words.action(study, n) for n in _beside_causes(study, 0.0) if not effect_words.is_noise(n)]
    if not swing.causes:
        said = ["Put the loop in manual for five periods. If the swing stops, look at valve and tuning; if it goes on, "
                "look outside this loop."] * study.range.oscillating + others
        return "To do: " + " ".join(filter(None, said)) if any(said) else ""
    sticks = study.verdict.stiction == "stiction"
    said = []
    for s in sorted(swing.causes, key=lambda s: -s.share):
        if s.share < _ACTED_ON:
            continue
        if s.part == Share.VALVE:
            said += [_service(study)] if sticks else []
            said += ["Test the valve in manual before any work on it."] * (study.verdict.stiction == "undecided")
        elif s.part not in (Share.SETPOINT, Share.NOISE, Share.START):
            said.append(effect_words.action(study, s.part))
    idle = "" if said else ("The valve can wait: its friction hardly moves PV." if sticks else
                            "Nothing to repair on this valve by this record.")
    said = list(filter(None, [*said, *others]))
    return " ".join(filter(None, [idle, "To do: " + " ".join(said) if said else ""]))


def valve_change(study: Study) -> Finding | None:
    """The finding that the valve changed within the record; None where the last model has no such change."""
    return next((f for step in study.steps[-1:] for f in step.findings if f.code == VALVE_CHANGED), None)


def _service(study: Study) -> str:
    """The work on a valve that moves PV; a check where its S fell within the record, since most of that was before."""
    found = valve_change(study)
    before, now = (found.evidence["S"] or (0.0, 0.0)) if found is not None else (0.0, 0.0)
    if now < before:
        return "S fell within this record, so look at the swing since then before any work on the valve."
    return "Service the valve: packing, actuator and positioner."


def asked_position(study: Study) -> str:
    """The answer of the measured position, where a model fails that was fitted without it; empty elsewhere."""
    e = study.estimate
    p = e.from_position if e is not None else None
    if e is None or p is None or p.rmse_proportional is None or study.adequate is not False:
        return ""
    return (f"The measured position gives S {wording.with_unit(p.S, e.unit)} and J {wording.with_unit(p.J, e.unit)}. "
            f"These two leave {wording.number(p.rmse)} of it, where a position in proportion to OP leaves "
            f"{wording.number(p.rmse_proportional)}. The rest acts between OP and stem, such as a positioner, a stop "
            "or friction that changes.")


def section(study: Study) -> Section | None:
    """Contributions and causes as a table; None where the study has neither."""
    swing = study.swing
    if swing is None:
        return None
    causes = {s.part: s for s in swing.causes}
    parts = {s.part: s for s in swing.parts}
    names = list(dict.fromkeys([*parts, *causes]))
    of = dict(zip(parts, shares(list(parts.values())), strict=True))
    by = dict(zip(causes, shares(list(causes.values())), strict=True))
    labels = {n: effect_words.fitted_part(study, n) if n in parts else effect_words.part(study, n) for n in names}
    rows = tuple((labels[n], of.get(n, wording.NOTHING), by.get(n, wording.NOTHING))
                 for n in names if {of.get(n, "0 %"), by.get(n, "0 %")} != {"0 %"})
    said = wording.listed([f"{of[n]} {labels[n]}" for n in parts if abs(parts[n].share) >= _SHOWN])
    why = ("The causes come from the same loop run again with a perfect valve: in a closed loop the parts go "
           "together, so that the parts alone do not say what swings it." if causes else
           wording.sentence(f"No share of the swing is given to a cause: {simulated(swing.reason)}"))
    table = PageTable("Parts of PV about its mean, and causes of its swing about the setpoint",
                      ("part", "share of PV about its mean", "cause of the swing about the setpoint"), rows, (1, 2))
    return Section("swing", "What makes the loop swing", (f"The fitted parts of PV about its mean: {said}.", why), (),
                   (table,), ("contributions",))
