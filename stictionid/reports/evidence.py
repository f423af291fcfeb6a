"""Evidence for every named effect in words: its size, what speaks for it, what looks alike, and what to do.

Every effect file brings its own texts.
"""

from __future__ import annotations

from ..record.loop import Finding
from ..record.study import Step, Study
from . import effect_words, wording
from .document import Section

# Most effects with a section of their own; the tables have all.
_MOST = 8
# Free-run error after an effect, as a share of that before it, from which the effect asks for no work. Unit: 1.
_HARDLY = 0.95
# Answers on an effect that was added by hand, by the code of their finding.
_ANSWERS = {"supported": "by hand, supported", "not-supported": "by hand, not supported",
            "cannot-tell": "by hand, open"}


def sections(study: Study) -> tuple[Section, ...]:
    """One section for each effect of the last step, in the order of the steps; those of the base come first."""
    found: list[Section] = []
    seen: set[str] = set()
    for i, step in enumerate(study.steps):
        for k, name in enumerate(step.effects if not i else (effect_words.named_in(step),) * bool(step.added)):
            if name not in seen and (name in study.steps[-1].effects):
                seen.add(name)
                picture = f"evidence-{i}" if i else f"evidence-0-{k}"
                found.append(_section(study, i, name, f"evidence-of-{len(found) + 1}", picture))
    return tuple(found[-_MOST:])


def _section(study: Study, i: int, name: str, key: str, picture: str) -> Section:
    effect, _ = effect_words.known(name)
    noun = effect_words.noun(study, name)
    bullets = [_support(study, i)]
    if alike := _alike(study, name):
        bullets.append(f"Could also be: {'; '.join(alike)}.")
    if effect is not None and effect.settled_by:
        bullets.append(f"What settles it: {effect.settled_by}.")
    if (act := effect_words.action(study, name)) and not _weak(study, i):
        bullets.append(f"What to do: {act}")
    title = f"Evidence: {noun}" + (f" ({wording.name(name)})" if noun != wording.name(name) else "")
    return Section(key, title, (effect_words.sentence(study, name),), tuple(bullets), pictures=(picture,))


def _weak(study: Study, i: int) -> bool:
    """True for a step that hardly lowers the free-run error of a model that still misses something."""
    return i > 0 and study.adequate is False and \
        study.steps[i].error.best > _HARDLY * study.steps[i - 1].error.best


def by_hand(step: Step) -> Finding | None:
    """The finding on an effect that was added by hand; None where a search added it."""
    return next((f for f in step.findings if f.code in _ANSWERS), None)


def flag(step: Step) -> str:
    """The answer on an effect added by hand, as a mark behind its name; empty where a search added it."""
    found = by_hand(step)
    return f" ({_ANSWERS[found.code]})" if found is not None else ""


def _support(study: Study, i: int) -> str:
    """The change of the error with the effect, and its gain beyond noise, under the side that they speak for."""
    step = study.steps[i]
    if not i:
        return "Speaks for it: the base model holds it, because without it the search found none that does as well."
    before, after = study.steps[i - 1].error, step.error
    rises = after.rmse > before.rmse
    said = (f"Speaks {'against' if rises else 'for'} it: with it the free-run error {'rises' if rises else 'falls'} "
            f"from {wording.number(before.rmse)} to {wording.number(after.rmse)}")
    if before.rmse_holdout is not None and after.rmse_holdout is not None:
        said += (f", on stretches held out of the fit from {wording.number(before.rmse_holdout)} to "
                 f"{wording.number(after.rmse_holdout)}")
    if (found := by_hand(step)) is not None:
        return f"{said}. It was added by hand: {wording.clean(found.statement)}."
    gain = next((c.gain_beyond_noise for c in study.candidates if c.effect == step.added), None)
    said += f"; it gains {wording.number(gain)} BIC beyond noise." if gain else "."
    return said + (" The free run hardly changes, so that this asks for no work on the valve."
                   if _weak(study, i) and not rises else "")


def _alike(study: Study, name: str) -> list[str]:
    """Effects that could look the same, each with the test that tells it apart."""
    effect, _ = effect_words.known(name)
    if effect is None:
        return []
    same = next((c.equivalent_to for c in reversed(study.candidates) if c.accepted and c.effect == effect.name), ())
    found = []
    for other in dict.fromkeys((*same, *effect.told_apart, *effect.confused_with)):
        rival, _ = effect_words.known(other)
        words = f"{wording.name(other)}" + (f", {rival.summary}" if rival is not None else "")
        apart = effect.told_apart.get(other)
        found.append(words + (f" (told apart by {apart})" if apart else ""))
    return found
