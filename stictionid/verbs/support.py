"""Judgement of an effect that a user added: supported, not supported, or can't tell, by the gates of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..effects import parse
from ..fit.cross_validation import blocks_won
from ..fit.points.held_out_blocks import stated_error
from ..record.loop import Finding
from ..record.tree import Gate
from ..selection.decide import best_without
from ..selection.entry import Entry
from ..selection.gates import GAIN, judge_edge, margin_of
from ..selection.node import BASE_EFFECTS, physical_effects, plain_name
from ..selection.score import Scored, is_noise, noise_name
from ..selection.search import Search

SUPPORTED, REJECTED, OPEN = "supported", "not-supported", "cannot-tell"
CODES = (SUPPORTED, REJECTED, OPEN)
SOURCE = "Kass and Raftery 1995"
# Gates that a record which is short, quiet, or slower than the scan may fail for a true effect: where only they fail,
# the record can't tell.
_OF_THE_RECORD = {GAIN, "strokes", "held-out"}


@dataclass(frozen=True, slots=True)
class Support:
    """Answer on one added effect: True, False, or None where the record can't tell; and the finding that says why."""

    supported: bool | None
    finding: Finding


def support_of(search: Search, winner: Entry, name: str, rose: bool = False) -> Support:
    """The answer on an effect of a winner, by its worth and by the gates against the winner without it.

    Where the free run `rose` when it was added no record supports it.
    """
    if is_noise(name):
        return _of_noise(winner.scored, name, search)
    before = _before(search, winner, name)
    child, parent = winner.scored, before.scored
    without = best_without(search, winner, plain_name(name))
    worth = winner.scored.done.gain_over(without.scored.done)
    margin = margin_of(name, search.policy, winner.scored.done)
    gates = judge_edge(search.memo.edge(before, name, child))
    failed = [g for g in gates if not g.passed and g.name != GAIN]
    if worth < margin:
        failed.append(Gate(GAIN, False, ""))
    answer = _answer(failed, worth, rose)
    code, said = {True: (SUPPORTED, f"the record supports {name}"),
                  False: (REJECTED, f"the record does not support {name}"),
                  None: (OPEN, f"the record can't tell whether {name} is there")}[answer]
    said += f": it gains {worth:.0f} BIC beyond noise, {margin:g} name an effect"
    after, held = child.held, parent.held
    errors = tuple(stated_error(s.done.model, s.held.rmse_one_step if s.held else None) for s in (parent, child))
    if after is not None and held is not None:
        won, blocks = blocks_won(after, held)
        said += f"; held out, the one-step error {_change(*errors)}, lower in {won} of {blocks} blocks"
    # (the gain is said above)
    said += "".join(f"; {g.reason}" for g in failed if g.name != GAIN)
    rival = _rival(winner, without) if worth < margin else ""
    if rival:
        said += f"; {rival} does {'better' if worth < 0.0 else 'nearly as well'}"
    evidence = {"gain_beyond_noise": worth, "margin": margin, "failed": [g.name for g in failed],
                "rmse_one_step_holdout": list(errors),
                "better": rival or None}
    return Support(answer, Finding(code, "info" if answer else "warning", said, evidence, (rival,) if rival else (),
                                   SOURCE))


def _change(before: float | None, after: float | None) -> str:
    """The change of a held-out error in words; None stands for one of a model that extrapolates."""
    first, last = ("that of a model that extrapolates" if e is None else f"{e:.4g}" for e in (before, after))
    return f"goes from {first} to {last}"


def _before(search: Search, winner: Entry, name: str) -> Entry:
    """The best model without an effect that has no others than the winner, but for those of a base."""
    mine = ({plain_name(n) for n in physical_effects(winner.spec)} | BASE_EFFECTS) - {plain_name(name)}
    search.drop_effect(winner, name)
    less = [e for e in search.memo.values() if e.scored.full and
            {plain_name(n) for n in physical_effects(e.spec)} <= mine]
    return max(less, key=lambda e: e.scored.done.gain_over(winner.scored.done))


def _rival(winner: Entry, without: Entry) -> str:
    """The effect that a model has and the winner lacks; empty where there is none."""
    have = {plain_name(name) for name in physical_effects(winner.spec)} | BASE_EFFECTS
    return next((name for name in physical_effects(without.spec) if plain_name(name) not in have), "")


def _answer(failed: Sequence[Gate], worth: float, rose: bool) -> bool | None:
    if not failed:
        return None if rose else True
    return None if worth > 0.0 and not rose and {g.name for g in failed} <= _OF_THE_RECORD else False


def _of_noise(scored: Scored, name: str, search: Search) -> Support:
    """A noise model is supported where it is the one that the residual of the model asks for."""
    wanted = noise_name(scored, search.policy, slow=search.slow)
    added = parse(name)[0].name
    if wanted == added:
        return Support(True, Finding(SUPPORTED, "info", f"the record supports {added}: the residual is such noise", {},
                                     (), SOURCE))
    said = f"the residual asks for {wanted}" if wanted else "the residual is white without a noise model"
    return Support(False, Finding(REJECTED, "warning", f"the record does not support {added}: {said}",
                                  {"better": wanted or None}, (wanted,) if wanted else (), SOURCE))
