"""One loop through `stictionid`, and the judgement of its answer: named right, errors, seconds.

An answer is right where every hidden effect is in it, or one that is declared alike, and nothing else. Names that the
truth holds anyway are allowed: the rest of a resting or inertial valve, a second lag, coloured noise.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from .design import plain
from .draw import Plant

NOISES = ("coloured-noise", "random-walk-disturbance", "narrow-band-disturbance")
S_WITHIN, J_WITHIN, ERROR_WITHIN = 0.02, 0.10, 1.05
EXACT, ALIKE, WRONG = "exact", "alike", "wrong"


def allowed(truth: dict[str, Any]) -> set[str]:
    """Names that are no false names for this truth, beside the hidden effects."""
    return {name for name, holds in (("re-sticking", truth["rests"]), ("extra-lag", truth["second_lag"]),
                                     ("coloured-noise", truth["coloured"])) if holds}


def named_right(hidden: Iterable[str], holds: set[str], answer: Iterable[str], alike: Iterable[tuple[str, str]],
                equivalents: Iterable[Iterable[str]]) -> str:
    """EXACT, ALIKE (with names declared alike, or by an equivalent model) or WRONG; all names without variants.

    `holds` are names that the truth holds anyway, `alike` pairs of names, `equivalents` answers shown as equally good.
    """
    wanted, said, pairs = {plain(n) for n in hidden}, {plain(n) for n in answer}, set(alike)
    if wanted <= said and said <= wanted | holds:
        return EXACT
    if any(wanted <= (other := {plain(n) for n in names}) and other <= wanted | holds for names in equivalents):
        return ALIKE
    # Each missing effect needs a name of its own among those that are too many.
    spare = said - wanted - holds
    for name in sorted(wanted - said):
        instead = next((s for s in sorted(spare | (said & holds)) if (s, name) in pairs or (name, s) in pairs), None)
        if instead is None:
            return WRONG
        spare.discard(instead)
    return WRONG if spare else ALIKE


def run(plant: Plant) -> dict[str, Any]:
    """Row of one loop: identify, diagnose with apply, and the judgement; an exception becomes a row with its text."""
    from stictionid.verbs.diagnose import diagnose
    from stictionid.verbs.identify import identify

    truth, row = plant.truth, {"truth": plant.truth, "identify_s": None, "diagnose_s": None}
    loop = loop_of(plant)
    begin = time.process_time()
    try:
        study = identify(loop)
        row["identify_s"] = time.process_time() - begin
        if study.steps:
            middle = time.process_time()
            study = diagnose(loop, study, apply=True)
            row["diagnose_s"] = time.process_time() - middle
    except Exception as error:
        return {**row, "cpu_s": time.process_time() - begin, "right": WRONG, "answer": [],
                "error": f"{type(error).__name__}: {error}"}
    row |= {"cpu_s": time.process_time() - begin, "verdict": study.verdict.stiction, "adequate": study.adequate,
            "reason": (study.adequate_reason or study.verdict.reason)[:200]}
    if not study.steps or study.estimate is None:
        return {**row, "right": WRONG, "answer": [], "abstained": True}
    return row | judged(study, truth)


def loop_of(plant: Plant) -> Any:
    """The exported record as a loop without its stem position."""
    from stictionid.record.loop import Loop

    record = plant.record
    return Loop(output=record.u, process_value=record.y, setpoint=record.r, step_s=float(plant.setting.export),
                extras={} if record.tag is None else {"D1": record.tag}, name=f"plant {plant.setting.seed}",
                units={"output": "%", "process_value": "%", "setpoint": "%"})


def judged(study: Any, truth: dict[str, Any]) -> dict[str, Any]:
    """Judgement of a study that has steps, in plain types."""
    last, estimate = study.steps[-1], study.estimate
    answer = sorted({plain(name) for name in last.effects})
    equivalents = [sorted(names) for names in _equivalents(study)]
    right = named_right(truth["hidden"], allowed(truth), answer, _alike(study, answer), equivalents)
    hidden = {plain(name) for name in truth["hidden"]}
    noisy = bool(hidden & set(NOISES))
    error = (last.error.rmse_one_step or last.error.rmse) / truth["innovation_sd"] if noisy \
        else last.error.rmse / truth["noise_sd"]
    path_error = error if noisy else last.error.best / truth["noise_sd"]
    inside = estimate.J_interval is not None and estimate.J_interval[0] <= truth["J"] <= estimate.J_interval[1]
    S_error, J_error = estimate.S / truth["S"] - 1.0, estimate.J / truth["J"] - 1.0
    return {
        "answer": answer, "right": right, "equivalents": equivalents,
        "false": sorted(set(answer) - hidden - allowed(truth)) if right == WRONG else [],
        "S": estimate.S, "J": estimate.J, "S_interval": estimate.S_interval, "J_interval": estimate.J_interval,
        "S_error": S_error, "J_error": J_error, "S_good": abs(S_error) <= S_WITHIN,
        "J_good": abs(J_error) <= J_WITHIN or inside, "error_over_noise": error,
        "error_good": error <= ERROR_WITHIN, "path_error_over_noise": path_error,
        "path_error_good": path_error <= ERROR_WITHIN, "slips_moved": last.error.slips_moved,
        "rmse": last.error.rmse, "one_step": last.error.rmse_one_step,
        "found": {name: {p.name: p.value for p in last.parameters if plain(p.effect or "") == name}
                  for name in sorted(hidden & set(answer))},
        "steps": [[s.added, s.error.rmse / truth["noise_sd"]] for s in study.steps],
        "candidates": [[c.effect, c.accepted, c.delta_bic] for c in study.candidates[:5]],
    }


def _alike(study: Any, answer: list[str]) -> set[tuple[str, str]]:
    """Pairs declared alike: by the catalogue, and by the candidates of this study that are in the answer."""
    from stictionid.effects import catalogue

    pairs = {(name, other) for name, effect in catalogue().items() for other in effect.confused_with}
    for candidate in study.candidates:
        others = {plain(name) for name in candidate.equivalent_to}
        pairs |= {(plain(candidate.effect), other) for other in others}
    return pairs


def _equivalents(study: Any) -> list[set[str]]:
    """Sets of effects of the models that a study declares equally good, whatever the form in which it lists them."""
    found = []
    for one in getattr(study, "equivalents", None) or ():
        if isinstance(one, str):
            names: Iterable[str] = one.replace(" ", "").split("+")
        elif isinstance(one, dict):
            names = one.get("effects", ())
        else:
            names = getattr(one, "effects", one)
        found.append({plain(str(name)) for name in names})
    return found
