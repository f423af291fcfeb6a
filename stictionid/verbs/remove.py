"""The verb `remove`: one effect taken out of a study again, the later ones refitted without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..effects import parse
from ..errors import UsageError
from ..fit.add_effect import added, polished
from ..fit.context import Run
from ..fit.fit import Fitted, as_it_stands
from ..fit.noise.completion import own_taps, quick
from ..model.restore import rebuild_model
from ..model.segments import bound
from ..record.loop import Finding, Loop
from ..record.study import Step, Study
from ..record.tree import Gate, TreeNode
from ..selection.ladder import step_of
from ..selection.node import plain
from ..selection.steps import opened, with_steps
from ..typing import Progress
from .add import asked_anew

# BIC beyond noise from which the record asks for an effect (CRITICISM.md section 7, step 7: "named").
_ASKED_FOR = 10.0
_SOURCE = "CRITICISM.md section 7, step 7"


def remove(loop: Loop, study: Study, effect: str, *, seed: int = 0, progress: Progress | None = None) -> Study:
    """The study without `effect`: the steps before it stay, the later ones are fitted anew, the verdict is that of the
    last model.

    A finding of the last step says what the effect was worth. Candidates and equivalents of the model before are
    dropped. Raises UsageError for an effect that the model does not have; DataError for an abstained study.
    """
    tell = progress or (lambda text, share: None)
    run, before = opened(loop, study, seed)
    gone = _named(effect, before.model.spec.effects)
    first = next(i for i, step in enumerate(study.steps) if set(gone) & set(step.model.get("effects", ())))
    tell(f"taking {gone[0]} out", 0.1)
    fit = _below(run, study.steps[max(first - 1, 0)], gone)
    steps = [*study.steps[:first]] or [step_of(run, fit, None)]
    later = [name for name in before.model.spec.effects if name not in gone and name not in fit.model.spec.effects]
    for i, name in enumerate(_in_order(later, study.steps)):
        tell(f"refitting with {name}", 0.2 + 0.6 * i / len(later))
        fit = added(fit, name, run.rng)
        steps.append(step_of(run, fit, name))
    steps[-1] = replace(steps[-1], findings=(*steps[-1].findings, _worth(gone[0], before, fit)))
    tell("judging", 0.9)
    after = with_steps(replace(study, candidates=(), equivalents=(), missing_reason="",
                               tree=tuple(_off_the_path(n, gone) for n in study.tree)), tuple(steps), fit)
    return asked_anew(loop, after, seed)


def _named(effect: str, have: Sequence[str]) -> tuple[str, ...]:
    """The names under which the model has an effect; UsageError where it has none."""
    wanted, variant = parse(effect)
    found = tuple(name for name in have if plain(name) == wanted.name and (not variant or name == effect))
    if not found:
        raise UsageError(f"the model has no effect {effect}", "its effects: " + (", ".join(have) or "none"))
    return found


def _below(run: Run, step: Step, gone: Sequence[str]) -> Fitted:
    """The fit of a step without some effects, polished, with intervals."""
    model, values = rebuild_model(run.loop, step.model)
    if not set(gone) & set(model.spec.effects):
        return polished(model, values, run.rng)
    spec = replace(model.spec, effects=tuple(n for n in model.spec.effects if n not in gone), taps=own_taps(model.spec))
    free = bound(model.loop, spec, s_max=model.s_max, period_s=model.period_s,
                 residual=as_it_stands(model, values).best.left)
    return polished(free, free.vector(model.named(values)), run.rng)


def _in_order(names: Sequence[str], steps: Sequence[Step]) -> list[str]:
    """Names of effects in the order in which the steps added them."""
    added_at = {name: i for i, step in reversed(list(enumerate(steps))) for name in step.model.get("effects", ())}
    return sorted(names, key=lambda name: added_at.get(name, len(steps)))


def _worth(name: str, before: Fitted, after: Fitted) -> Finding:
    """The finding on an effect that was taken out: its worth in BIC, both models completed with noise."""
    worth = quick(before.model, before.values).gain_over(quick(after.model, after.values))
    asked = worth > _ASKED_FOR
    said = ("the record asks for it" if asked else "the record does not ask for it")
    return Finding("removed", "warning" if asked else "info",
                   f"{name} was taken out by hand: the free-run error goes from {before.best.rmse:.4g} to "
                   f"{after.best.rmse:.4g}, and it was worth {worth:.0f} BIC beyond noise, so {said}",
                   {"effect": name, "rmse_before": before.best.rmse, "rmse_after": after.best.rmse, "bic": worth},
                   (plain(name),) if asked else (), _SOURCE)


def _off_the_path(node: TreeNode, gone: Sequence[str]) -> TreeNode:
    """A node of the tree; one of the answer's path that has an effect taken out is no longer on it."""
    if node.status != "named" or not set(gone) & set(node.effects):
        return node
    return replace(node, status="rejected", gates=(*node.gates, Gate("by hand", False, "taken out by hand")))
