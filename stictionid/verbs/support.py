"""Judgement of an effect that a user added: supported, not supported, or can't tell, by the gates of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..effects import parse
from ..fit.context import Run
from ..fit.cross_validation import held_out
from ..fit.fit import Fitted
from ..model.segments import bound
from ..record.loop import Finding
from ..record.study import Study
from ..record.tree import Gate, added_to
from ..selection.gates import LASTS, Edge, judged, margin_of
from ..selection.looks import pool_of
from ..selection.node import node, physical
from ..selection.policy import Policy
from ..selection.score import Scored, completed, is_noise, noise_name

SUPPORTED, REJECTED, OPEN = "supported", "not-supported", "cannot-tell"
CODES = (SUPPORTED, REJECTED, OPEN)
# Gates that a short or quiet record may fail for a true effect: where only they fail, the record can't tell.
_OF_THE_RECORD = {"gain", "blocks", "strokes", "held-out"}
# BIC by which another effect must beat the one added to be named instead. Source: Kass and Raftery 1995, positive.
_BETTER = 2.0
_SOURCE = "CRITICISM.md section 7, steps 6 and 7"


@dataclass(frozen=True, slots=True)
class Support:
    """Answer on one added effect: True, False, or None where the record can't tell; and the finding that says why."""

    supported: bool | None
    finding: Finding


def support_of(run: Run, study: Study, before: Fitted, after: Fitted, name: str, policy: Policy) -> Support:
    """The answer on the effect `name`, by which the fit `after` differs from `before`, both completed with noise.

    The tree of the study, where it has one, names the effect that does better.
    """
    parent = _scored(run, before, policy)
    if is_noise(name):
        return _of_noise(parent, name, policy)
    child = _scored(run, after, policy)
    edge = Edge(name, child, parent, policy)
    gates = judged(edge)
    failed = [g for g in gates if not g.passed]
    better = _better(study, before, name, edge.gain)
    answer = _answer(failed, edge, better is not None)
    code = {True: SUPPORTED, False: REJECTED, None: OPEN}[answer]
    said = {True: f"the record supports {name}", False: f"the record does not support {name}",
            None: f"the record can't tell whether {name} is there"}[answer]
    said += f": it gains {edge.gain:.0f} BIC beyond noise, {edge.margin:g} name an effect"
    if child.held is not None and parent.held is not None:
        said += (f"; held out, the one-step error goes from {parent.held.rmse_one_step:.4g} to "
                 f"{child.held.rmse_one_step:.4g}")
    names = {g.name for g in failed}
    # One sentence on the blocks is enough, and the gain is said above.
    said += "".join(f"; {g.reason}" for g in failed if g.name != "gain" and (g.name != "blocks" or
                                                                           "held-out" not in names))
    said += "".join(f"; but {g.reason}" for g in gates if g.name == LASTS)
    if better is not None:
        said += f"; {better[0]} does better, it gains {better[1]:.0f}"
    evidence = {"gain_beyond_noise": edge.gain, "margin": margin_of(name, policy), "failed": [g.name for g in failed],
                "rmse_one_step_holdout": [s.held.rmse_one_step if s.held else None for s in (parent, child)],
                "better": better[0] if better else None}
    return Support(answer, Finding(code, "info" if answer else "warning", said, evidence,
                                   (better[0],) if better else (), _SOURCE))


def _scored(run: Run, fit: Fitted, policy: Policy) -> Scored:
    """The model of a fit without its noise effects, completed with the best noise, with held-out errors."""
    old = fit.model
    model = bound(old.loop, node(old.spec), s_max=old.s_max, period_s=old.period_s, residual=fit.best.left)
    done = completed(model, model.vector(old.named(fit.values)), pool_of(fit, run.options.seed), run.rng, policy)
    return Scored(done, True, held_out(done))


def _answer(failed: Sequence[Gate], edge: Edge, beaten: bool) -> bool | None:
    if not failed:
        return None if beaten else True
    return None if edge.gain > 0.0 and not beaten and {g.name for g in failed} <= _OF_THE_RECORD else False


def _of_noise(parent: Scored, name: str, policy: Policy) -> Support:
    """A noise model is supported where it is the one that the residual of the model before asks for."""
    wanted = noise_name(parent, policy)
    added = parse(name)[0].name
    if wanted == added:
        return Support(True, Finding(SUPPORTED, "info", f"the record supports {added}: the residual is such noise", {},
                                     (), _SOURCE))
    said = f"the residual asks for {wanted}" if wanted else "the residual is white without a noise model"
    return Support(False, Finding(REJECTED, "warning", f"the record does not support {added}: {said}",
                                  {"better": wanted or None}, (wanted,) if wanted else (), _SOURCE))


def _better(study: Study, before: Fitted, name: str, gain: float) -> tuple[str, float] | None:
    """The effect that beats `gain` beside the same model in the study's tree, and its gain; one on the path first."""
    plain = parse(name)[0].name
    found = [(n.status == "named", theirs, n.edge.what)
             for n, theirs in added_to(study.tree, physical(before.model.spec))
             if theirs > gain + _BETTER and parse(n.edge.what)[0].name != plain and n.status != "failed"
             and all(g.passed for g in n.gates)]
    return (max(found)[2], max(found)[1]) if found else None
