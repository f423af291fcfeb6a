"""The verb `remove`: one effect taken out of a study again, the others refitted without it."""

from __future__ import annotations

from collections.abc import Sequence

from ..effects import parse
from ..errors import UsageError
from ..record.loop import Finding, Loop
from ..record.study import Study
from ..selection.decide import best_without
from ..selection.node import plain_name
from ..selection.run import Resumed, resume_search
from ..selection.score import is_noise
from ..typing import Progress
from .by_hand import asked_for, of_effects, taken_out, with_finding
from .support import SOURCE

# BIC beyond noise from which the record asks for an effect. Source: Kass and Raftery 1995, very strong evidence.
_ASKED_FOR = 10.0


def remove(loop: Loop, study: Study, effect: str, *, seed: int = 0, progress: Progress | None = None) -> Study:
    """The study without `effect`, its model as a search with the other effects would have it, and its verdict.

    A finding of the last step says what the effect was worth. The noise is completed anew, and parts that a search put
    in go where they are needless. Raises UsageError for an effect that the model does not have; DataError for an
    abstained study.
    """
    tell = progress or (lambda text, share: None)
    on = resume_search(loop, study, seed=seed, progress=progress)
    gone = _named(effect, on.fit.model.spec.effects)
    tell(f"taking {gone[0]} out", 0.1)
    asked = tuple(name for name in asked_for(study) if name not in gone)
    noise = next((name for name in asked if is_noise(name)), "")
    entry = taken_out(on, [name for name in gone if not is_noise(name)])
    after, _ = of_effects(loop, on, entry, keep=asked, asked=asked, noise=noise, gone=gone)
    return with_finding(after, _removed(on, gone[0], study, after))


def _named(effect: str, have: Sequence[str]) -> tuple[str, ...]:
    """The names under which the model has an effect; UsageError where it has none."""
    wanted, variant = parse(effect)
    found = tuple(name for name in have if plain_name(name) == wanted.name and (not variant or name == effect))
    if not found:
        raise UsageError(f"the model has no effect {effect}", f"its effects: {', '.join(have)}" if have else
                         "it has no effect at all; stictionid add puts one in")
    return found


def _removed(on: Resumed, name: str, before: Study, after: Study) -> Finding:
    """The finding on an effect that was taken out: its worth in BIC beyond noise; a noise model has none."""
    errors = [study.steps[-1].error.best for study in (before, after)]
    said = f"{name} was taken out by hand: the free-run error goes from {errors[0]:.4g} to {errors[1]:.4g}"
    evidence = {"effect": name, "rmse_before": errors[0], "rmse_after": errors[1]}
    if is_noise(name):
        return Finding("removed", "info", said, evidence, (), SOURCE)
    without = best_without(on.search, on.here, plain_name(name))
    worth = on.here.scored.done.gain_over(without.scored.done)
    asked = worth > _ASKED_FOR
    said += f", and it was worth {worth:.0f} BIC beyond noise, so the record "
    said += "asks for it" if asked else "does not ask for it"
    return Finding("removed", "warning" if asked else "info", said, {**evidence, "bic": worth},
                   (plain_name(name),) if asked else (), SOURCE)
