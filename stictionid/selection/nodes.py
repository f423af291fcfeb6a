"""Nodes that a search has met: which are explained, which is best, and what they are without one effect.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..effects import parse
from ..fit.noise.completion import Refit
from ..fit.starts.beside_effect import RESTING
from ..fit.valves_by_paths import move_all_slips
from ..model.spec import Spec
from ..record.loop import Loop
from ..typing import Progress
from .crew import Budget
from .doubts import fit_dropped, offer_rest
from .entry import Entry, Memo, rank_entries, remember
from .looks import Packed, Task
from .node import additions, depth, key, slips_like_rests, valve_effects
from .policy import Policy
from .refits import settle_again
from .score import Scored


@dataclass(slots=True)
class Nodes:
    """Nodes by key, evaluations spent, nodes not asked: all that a search over the models of one record knows."""

    loop: Loop
    policy: Policy
    seed: int
    jobs: int
    tell: Progress
    only: frozenset[str] | None = None
    commands: tuple[Spec, ...] = ()
    memo: Memo = field(init=False)
    valves: dict[str, tuple[dict[str, float], ...]] = field(default_factory=dict)
    # Nodes with one effect taken out, by node, effect and innovations: the decision needs the same ones several times.
    drops: dict[tuple[str, str, float], Entry] = field(default_factory=dict)
    # Answers for which the other kind of valve was searched.
    rested: set[str] = field(default_factory=set)
    # False once the search has found valves by paths, for a base, beside effects, and beside a level that wanders.
    may_place: bool = True
    may_replace: bool = True
    may_wander: bool = True
    budget: Budget = field(init=False)
    # True where the search was made for the whole catalogue, whatever is left out of it later.
    whole: bool = field(init=False)
    # True where the record is slower than the controller's scan; the number of scans in a sample that may be rebuilt.
    slow: bool = False
    scans: int = 1
    # True where the controller also moved the output between the samples, which the record does not show.
    blurred: bool = False
    # Irreducible noise in the unit of y for a completed model; None where the record is too short.
    floor: Callable[[Refit], float | None] = lambda done: None

    def __post_init__(self) -> None:
        # A record longer than the part that looks search on gets a larger budget.
        longer = float(np.sqrt(max(self.loop.samples / self.policy.fit_samples, 1.0)))
        self.budget, self.whole = Budget(self.policy.budget * longer, self.policy.unit), self.only is None
        self.memo = Memo(self.policy, self.blurred)

    def at_end(self, entry: Entry) -> bool:
        """True where an entry's free run is white noise, or it was expanded and leaves white innovations.

        Before that the autoregression may stand for a disturbance, and slips that PV moved for a missing effect.
        """
        scored = entry.scored
        return scored.unresolved or (scored.white and scored.free_run_at_noise and not scored.by_pv) or (
            entry.asked and (scored.white or self.only_noise(entry)))

    def best(self) -> Entry:
        """The entry with the best BIC among those that passed all gates."""
        return rank_entries(self.memo)[0]

    def drop_effect(self, entry: Entry, name: str) -> Entry:
        """The node without one effect: as it was met, or fitted from an entry's values, whichever is better."""
        asked = key(entry.spec), name, entry.scored.done.innovation_sd
        if asked not in self.drops:
            self.drops[asked] = fit_dropped(self.memo, entry, name, self.seed, self.policy)
        return self.drops[asked]

    def _needs_fit(self, task: Task) -> bool:
        """True for a node without a full fit that no earlier search has looked at and rejected."""
        known = self.memo.get(key(task.spec))
        return known is None or (not known.scored.full and known.look is not None)

    def _score_of(self, answer: Packed) -> Scored:
        """Score of the node that an answer led to."""
        return self.memo[key(answer.spec)].scored

    def find_doubt(self, entry: Entry) -> tuple[Entry, tuple[str, ...]] | None:
        """A node and effects to add to it where the answer may be another valve; else None."""
        spec = entry.spec
        if self.budget.share >= 2 or entry.scored.unresolved:
            return None
        if slips := slips_like_rests(spec):
            before = self.drop_effect(entry, slips)
            offer_rest(self.valves, entry.scored.done, slips, before.spec)
            return (before, (RESTING,)) if RESTING in additions(before.spec, self.loop, self.only) else None
        # A slip jump above the stickband is doubtful, and so is a base that leaves far more than noise.
        far = not (self.budget.over or depth(spec) or entry.scored.leaves_little(self.policy))
        if spec.held and not (entry.scored.jumps_past or far):
            return None
        if RESTING in additions(spec, self.loop, self.only):
            return entry, (RESTING,)
        # Under a command that moves between samples a valve with slip overshoot looks like one that rests.
        if RESTING not in spec.effects or (spec.held and self.only_noise(entry)):
            return None
        slides = self.drop_effect(entry, RESTING)
        names = tuple(n for n in additions(slides.spec, self.loop, self.only) if parse(n)[0].slides)
        return (slides, names) if names else None

    def settle_node(self, entry: Entry) -> None:
        """Fit a node with effects once more, unless it is explained."""
        if not entry.settled and entry.spec.effects and not self.is_explained(entry):
            entry.scored = settle_again(entry.scored, entry.spec, self.seed, self.policy)
        entry.settled = True

    def move_slips(self, entry: Entry) -> Entry:
        """An entry whose slips all came earlier or later, where that is likelier beside its noise."""
        if entry.moved is not entry.scored:
            if (moved := move_all_slips(entry.scored.done)).gain_over(entry.scored.done) > self.policy.better_fit:
                entry.scored = Scored(moved)
            entry.moved = entry.scored
        return entry

    def only_noise(self, entry: Entry) -> bool:
        """True where an entry leaves noise of short memory, or is explained."""
        return entry.scored.noise_alone or self.is_explained(entry)

    def _is_carried_by_noise(self, entry: Entry) -> bool:
        """True where noise explains the free-run error: a walk with white innovations, its floor, or short memory."""
        scored = entry.scored  # (a hunting positioner passed for short memory of more than half, with S 31 % off)
        return scored.unresolved or (scored.white and scored.done.increments) or self._at_floor(scored) or (
            self.only_noise(entry) and scored.rmse <= 2 * scored.done.innovation_sd)

    def is_explained(self, entry: Entry) -> bool:
        """True where the innovations are white and the free-run error hardly larger, or near the irreducible noise."""
        scored = entry.scored
        # Tests for whiteness reject every model of a long record, and one whose command is rebuilt between samples.
        untold = not scored.white and (not entry.spec.held or self.loop.samples > 2 * self.policy.unit)
        return scored.is_explained(self.policy) or (untold and self._at_floor(scored))

    def _remember_valve(self, entry: Entry, spec: Spec, done: Refit) -> Entry:
        """The node of a model along its slips, put in the memo beside an entry."""
        scored = Scored(done)
        if key(spec) != key(entry.spec):
            task = Task(spec, RESTING if valve_effects(spec) and not valve_effects(entry.spec) else "")
            remember(self.memo, entry, task, Packed(spec), scored)
        elif scored.done.gain_over(entry.scored.done) > self.policy.better_fit:
            entry.scored, entry.asked = scored, False
        return self.memo[key(spec)]

    def least_in_free_run(self, entry: Entry) -> Entry | None:
        """The node with effects, fitted in full, of least free-run error, where that halves an entry's; else None."""
        full = [e for e in self.memo.values() if depth(e.spec) and e.scored.full]
        least = min(full, key=lambda e: e.scored.rmse, default=entry)
        return least if 2 * least.scored.rmse <= entry.scored.rmse else None

    def noise_of(self, entry: Entry) -> float:
        """Irreducible noise in the unit of y for an entry, or its innovations where the record is too short to tell."""
        return self.floor(entry.scored.done) or entry.scored.done.innovation_sd

    def _is_far(self, entry: Entry) -> bool:
        """True where an entry leaves far more than its noise. Errors of landing are none; noise of short memory is."""
        scored = entry.scored
        noise = scored.done.error_with_colour if scored.noise_alone else self.noise_of(entry)
        return scored.rmse > self.policy.nearly * noise

    def _at_floor(self, scored: Scored) -> bool:
        floor = self.floor(scored.done)
        return floor is not None and scored.rmse <= self.policy.carried * floor
