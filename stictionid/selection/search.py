"""Best-first search over models: expand the best node, fit what may win in full, hand better values back.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

from ..effects import parse
from ..fit.noise.completion import Refit, explains_slips, place_slips
from ..fit.points.fitted import Fitted, as_it_stands
from ..fit.starts.beside_effect import LAG, RESTING, on_valve
from ..fit.valves_by_paths import WANDERS, along_path_of, look_beside_wander, valves_by_paths, without_level
from ..model.segments import rebind_model
from ..model.spec import BASE, Spec
from ..paths.settle import scatters_at_most
from ..process.scan import DECIMATED
from .crew import Crew
from .doubts import add_valves, lacking_load_steps
from .entry import (
    ROOT,
    SWAP,
    Entry,
    better_base,
    children_of,
    failed_entry,
    nodes_to_ask,
    other_structures,
    remember,
)
from .gates import least_cost
from .looks import (
    ALONG,
    BESIDE,
    CLOSER,
    FAR,
    NEAR,
    Ground,
    Packed,
    Task,
    edge_adding,
    edges,
    keep_followed_tags,
    pool_of,
    rng_of,
)
from .node import (
    BASE_EFFECTS,
    additions,
    by_tag,
    depth,
    drop_from,
    hidden_by_lag,
    key,
    kind_of,
    leaking_process,
    node,
    other_commands,
    other_process,
    with_effect,
)
from .nodes import Nodes
from .refits import from_children
from .score import Scored, complete_with_noise, point_in_search_form


@dataclass(slots=True)
class Search(Nodes):
    """One search over the models of one record."""

    def root(self, fit: Fitted) -> Entry:
        """Add a fit made before the search as a root; of two fits of one node the better one stays."""
        spec, before = node(fit.model.spec), fit.model
        model = rebind_model(before, spec, fit.best.left)
        values = model.vector(fit.best.values)
        done = complete_with_noise(model, values, rng_of(self.seed, key(before.spec), 2), self.policy,
                                   lambda: pool_of(as_it_stands(model, values), self.seed))
        known = self.memo.get(key(spec))
        if known is None or done.gain_over(known.scored.done) > self.policy.better_fit:
            self.memo[key(spec)] = known = Entry(spec, Scored(done))
        return known

    def run(self, *, everything: bool = False) -> Entry:
        """Expand nodes, best first, until noise is left, nothing gains, or the budget is spent; the best node.

        With `everything` the best node is expanded first, even where it leaves only noise.
        """
        self._add_valves(self.best(), better=True)
        if everything and not self.best().asked:
            self.expand(self.best())
        if (tags := by_tag(self.best().spec, self.loop, self.only)) and not self.at_end(self.best()):
            # A tag is measured: where one explains the record, no other effect is asked for.
            self.ask_for(self.best(), tags)
        while key((best := self._expand_until_done()).spec) not in self.rested:
            self.rested.add(key(best.spec))
            self._add_valves(best)
            for entry in filter(None, (best, self.least_in_free_run(best))):
                self._ask_by_paths(entry)
            self._ask_commands(best)
            if doubted := self.find_doubt(best):
                self.ask_for(*doubted)
                self.ask_in_place(best, *doubted)
            self._ask_beside_wander(self.best())
        base = next(iter(self.memo.values()))
        late = additions(base.spec, self.loop, self.only, last=True) if self.whole else ()
        if late and not self.slow and self.budget.share < 2 and not self._is_carried_by_noise(best):
            self.ask_for(base, late, beside=best)
            best = self._expand_until_done()
        return best if self.slow or self._is_carried_by_noise(best) else self._ask_load_steps(base)

    def _ask_commands(self, entry: Entry) -> None:
        """Fit a base under other courses of its command, and beside coloured noise with a further lag, too."""
        for spec in other_commands(entry.spec, self.commands):
            found = self.fit_structure(entry, spec)  # (noise alone does not say which course is right)
            if found is not None and found.scored.done.taps.size and LAG in additions(spec, self.loop, self.only):
                self.ask_for(found, (LAG,), sure=True)

    def _ask_load_steps(self, entry: Entry) -> Entry:
        """The best node after load steps were asked, last: many of them imitate what any effect leaves."""
        while not self.budget.over and (steps := lacking_load_steps(self.memo, entry, self.only)):
            self.ask_for(self.drop_effect(entry, steps[1]) if steps[1] else entry, steps[:1])
            entry = self._expand_until_done()
        return self.best()

    def _expand_until_done(self) -> Entry:
        """The best node once noise is left, nothing gains, or the budget is spent."""
        widths: dict[int, int] = {}
        while True:
            best = self.best()
            if self.at_end(best):
                return best
            queue = nodes_to_ask(self.memo, only_some=not self.whole)
            queue = [e for e in queue if widths.get(depth(e.spec), 0) < self.policy.beam]
            if not queue:
                return best
            if self.budget.over:
                self.budget.note_unasked(key(e.spec) for e in queue if e is not best)
                if not depth(best.spec) or best not in queue:
                    return best
                with self.budget.allow_late_answer():
                    if self.budget.over:
                        return best
                    self.expand(best)
                continue
            widths[depth(queue[0].spec)] = widths.get(depth(queue[0].spec), 0) + 1
            self.expand(queue[0])

    def expand(self, entry: Entry) -> None:
        """Look at every edge of a node, fit the best looks in full, hand values back; repeat in a better basin."""
        ground, tasks = self._open_node(entry, "expanding")
        entry.asked, entry.along, before = True, ground.fit.model.spec.paths is not None, entry.scored.done
        if not any(on_valve(effect) for effect in ground.fit.model.effects):
            # A valve that rests is as common as one that slides, and its basin is far from that of a sliding one.
            self._search_valves(ground, entry, [t for t in tasks if t.added == RESTING])
        self._fit_best_looks(ground, entry, self._look_at_tasks(ground, entry, tasks))
        self._finish_children(entry)
        self._drop_needless()
        bases = [e for e in self.memo.values() if not depth(e.spec) and e.scored.full]
        self.fit_integrator(min(bases, key=lambda e: e.scored.rmse, default=entry))
        if depth((best := self.best()).spec):
            self.fit_integrator(best)
        self._ask_instead_of_lag(entry)
        if entry.op == ROOT or (self.commands and entry is self.best()):
            self._ask_structures(entry)
        if entry.scored.done.gain_over(before) > self.policy.margin:
            entry.asked = False

    def _open_node(self, entry: Entry, words: str) -> tuple[Ground, list[Task]]:
        """The ground that the looks of a node share, and the node's edges; `words` tell the progress."""
        self.tell(f"{words} {' + '.join(entry.spec.effects) or 'the base'}", min(self.budget.share, 1.0))
        fit = point_in_search_form(entry.scored, entry.spec)
        ground = Ground(fit, pool_of(fit, self.seed), self.seed, self.policy, self.valves)
        return ground, self._edges(fit.model.spec)

    def ask_for(self, entry: Entry, names: Sequence[str], *, changes: bool = False, beside: Entry | None = None,
                beyond: Entry | None = None, sure: bool = False) -> None:
        """Add effects that are not fitted yet to a node, one at a time; with `changes` change its structure, too.

        A growing-window search stops as soon as its residual exceeds that of `beside`. With `beyond` only looks better
        than that node are fitted; without it or `changes` the search has its own budget. A `sure` one is fitted fully.
        """
        ground, tasks = self._open_node(entry, f"asking for {names[0]} beside")
        if beside is not None:
            left = replace(ground.fit.best, residual=beside.scored.done.evaluated.left, followed=None)
            ground = replace(ground, fit=replace(ground.fit, best=left))
        asked = [edge_adding(ground.fit.model.spec, name) for name in names]
        asked = [*filter(self._needs_fit, asked), *(t for t in tasks if changes and not t.added)]
        with nullcontext() if changes or beyond is not None else self.budget.allow_last_question():
            self._search_valves(ground, entry, [t for t in asked if t.added == RESTING])
            looks = [a for a in self._look_at_tasks(ground, entry, asked)
                     if beyond is None or self._score_of(a).done.gain_over(beyond.scored.done) > 0.0]
            self._fit_best_looks(ground, entry, looks, sure)

    def ask_along(self, entry: Entry, names: Sequence[str] | None = None, fit: Fitted | None = None, *,
                  sure: bool = False) -> None:
        """Fit the best effects by looks along the path of an entry, or `names` alone along that of a fit of its node.

        A node far from its noise is first asked by the law, as every node is. The best of `sure` ones is fitted fully.
        """
        ground, _ = self._open_node(entry, "asking once more beside")
        if fit is None and entry.asked:
            fit = as_it_stands(entry.scored.done.model, entry.scored.done.values)
        ground = replace(ground, fit=fit or ground.fit)
        if names is None:
            names = additions(entry.spec, self.loop, self.only)
            entry.asked, entry.along = True, ground.fit.model.spec.paths is not None
        tasks = [replace(edge_adding(entry.spec, name), stage=ALONG) for name in names]
        with self.budget.allow_last_question():
            self._fit_best_looks(ground, entry, self._perform_tasks(ground, entry, tasks), sure)

    def ask_in_place(self, entry: Entry, before: Entry, names: Sequence[str], *, sure: bool = False) -> None:
        """Ask for effects beside a node along the path of an entry with another effect, if that has a path."""
        if (fit := along_path_of(entry.scored.done, before.spec)) is not None:
            self.ask_along(before, names, fit, sure=sure)

    def _add_valves(self, entry: Entry, *, better: bool = False) -> None:
        """Fit both kinds of valve with the slips of an entry, and put them in the memo (see `add_valves`)."""
        add_valves(self.memo, entry, self.loop, self.only, self.seed, self.policy, better=better)

    def _ask_by_paths(self, entry: Entry) -> None:
        """Fit the valves found along paths alone where an answer is far from its noise.

        It is asked once for a base and once beside effects. These were found beside another valve, which may be wrong:
        such a valve bends the score of an effect, but not how far it lowers the free-run error.
        Where a record shows every scan, the law places slips, and what a base leaves is an effect: that is asked first.
        Where PV moved the slips of an answer at its noise, the other kind of valve may have these slips by its law.
        """
        beside, far = depth(entry.spec) > 0, self._is_far(entry)
        if not (far or entry.scored.by_pv) or not (self.whole or self.slow) or not (
                self.may_replace if beside else self.may_place):
            return
        self.may_place, self.may_replace = self.may_place and beside, self.may_replace and not beside
        for done in map(place_slips, self._valves_by_paths(entry, other=not far)):
            # (else an effect is missing, and the slips take it up)
            if explains_slips(done) and not scatters_at_most(done.model, done.values):
                self._remember_valve(entry, node(done.model.spec), done)

    def _ask_beside_wander(self, entry: Entry) -> None:
        """Ask for disturbances beside valves that no slow disturbance bends, once for a record."""
        if not (self.may_wander and self.whole) or depth(entry.spec) or entry.scored.leaves_little(self.policy):
            return
        self.may_wander = False
        for done in self._valves_by_paths(entry, WANDERS):
            if done.gain_over(entry.scored.done) < -self.policy.within:
                continue  # (no level wanders: beside it the model would be likelier)
            fit = without_level(done)
            before = self._remember_valve(entry, node(fit.model.spec), look_beside_wander(fit))
            names = additions(before.spec, self.loop, self.only)
            self.ask_along(before, [n for n in names if on_valve(parse(n)[0])], fit)
            asked = [replace(edge_adding(fit.model.spec, n), stage=BESIDE) for n in names if parse(n)[0].columns]
            with self.budget.allow_last_question():
                self._look_beside_wander(fit, before, [*filter(self._needs_fit, asked)])

    def _valves_by_paths(self, entry: Entry, knots: int = 0, *, other: bool = False) -> list[Refit]:
        """Both kinds of valve found along paths, or the `other` one, under all courses of the command in the memo."""
        self.tell("placing the slips of any valve", min(self.budget.share, 1.0))
        may_rest = RESTING in (*entry.spec.effects, *additions(entry.spec, self.loop, self.only)) and not any(
            effect.slides for effect in entry.scored.done.model.effects)
        rests = [r for r in (False, True)[:1 + may_rest] if not other or r != (RESTING in entry.spec.effects)]
        courses = {entry.spec.between: entry.scored.done.model}
        for e in self.memo.values():
            if not (depth(e.spec) or e.failed):
                courses.setdefault(e.spec.between, e.scored.done.model)
        if self.scans > 1 and entry.spec.held and DECIMATED not in courses:
            done = entry.scored.done
            spec = replace(done.model.spec, between=DECIMATED, substeps=self.scans, paths=None)
            courses[DECIMATED] = rebind_model(done.model, spec, None)
        return valves_by_paths(courses.values(), entry.spec.process, rests=rests, knots=knots,
                               noise=self.noise_of(entry), beside=entry.scored.done if depth(entry.spec) else None,
                               rival=entry.scored.done)

    def _look_beside_wander(self, fit: Fitted, entry: Entry, tasks: Sequence[Task]) -> None:
        """Look at disturbances along the slips of a fit, and once more along those of the best look; fit the best."""
        for _ in range(2):
            ground = Ground(fit, fit.values[None, :len(BASE)], self.seed, self.policy, self.valves)
            looks = self._perform_tasks(ground, entry, tasks)
            if not looks:
                return
            # (one effect may be settled better than another that explains as much)
            best = place_slips(min((self.memo[key(a.spec)].scored.done for a in looks), key=lambda d: d.bic(d.good)))
            if (along := along_path_of(best, fit.model.spec)) is None:
                break
            fit = along
        self._fit_best_looks(ground, entry, looks)

    def _ask_structures(self, entry: Entry) -> None:
        """Add a rest to the node of every process, lag and command: two changes may help only together."""
        queue, seen = [entry], {key(entry.spec)}
        while queue and not self.budget.over and not self.only_noise(self.best()):
            base = queue.pop(0)
            if base is not entry and RESTING in additions(base.spec, self.loop, self.only):
                # Valves found without a further lag serve here, too: most were found with no process assumed.
                kind, known = (kind_of(with_effect(x, RESTING)) for x in (base.spec, drop_from(base.spec, (LAG,))))
                if known in self.valves:
                    self.valves.setdefault(kind, self.valves[known])
                self.ask_for(base, (RESTING,), changes=base.op == SWAP)
            found = {key(e.spec): e for e in other_structures(self.memo, entry, self.best())}
            queue += [e for name, e in found.items() if name not in seen]
            seen |= found.keys()

    def fit_integrator(self, entry: Entry) -> Entry | None:
        """The node with an integrator, whose level no effect imitates, in place of a lag of many periods; else None."""
        if entry.spec.fixed or not entry.scored.acts_as_integrator(self.policy):
            return None
        return self.fit_structure(entry, other_process(drop_from(entry.spec, (LAG,))))

    def _finish_children(self, entry: Entry) -> None:
        """Fit children once more from a node that is likelier: a larger model that explains less was not found.

        The node has the values of its best child by now, and the looks begin there.
        """
        lost = [t for t in edges(entry.spec, self.loop, self.only, ())
                if t.added and (known := self.memo.get(key(t.spec))) is not None and known.scored.full
                and known.scored.done.gain_over(entry.scored.done) <= -self.policy.margin]
        if not lost:
            return
        ground, _ = self._open_node(entry, "fitting once more beside")
        for task in lost:
            self._fit_whole(ground, entry, task)

    def _fit_whole(self, ground: Ground, entry: Entry, task: Task, *, always: bool = False) -> None:
        """Look at an edge of a node, and fit what is found in full; `always` ignores the budget."""
        looks = self._perform_tasks(ground, entry, [task], always=always)
        self._perform_tasks(ground, entry, [replace(task, look=look) for look in looks], always=always)

    def fit_structure(self, entry: Entry, spec: Spec) -> Entry | None:
        """The node of another structure, fitted in full from an entry; None where its fit failed."""
        if self._needs_fit(Task(spec)):
            ground, _ = self._open_node(entry, "asking for another structure beside")
            self._fit_whole(ground, entry, Task(spec), always=True)
        found = self.memo[key(spec)]
        return None if found.failed else found

    def _ask_instead_of_lag(self, entry: Entry) -> None:
        """Look at effects that a further lag may stand in for, in place of it; added to it they start far off."""
        if LAG not in entry.spec.effects or not self.whole or self.only_noise(self.best()):
            return
        without_lag = self.drop_effect(entry, LAG)
        if names := [n for n in additions(without_lag.spec, self.loop, self.only) if hidden_by_lag(parse(n)[0])]:
            self.ask_for(without_lag, names, beyond=entry)

    def _drop_needless(self) -> None:
        """Drop a lag or rest of the base that the best node no longer needs: it stood in for a missing effect."""
        best = self.best()
        for name in BASE_EFFECTS.intersection(best.spec.effects):
            if depth(best.spec) and not self.only_noise(best):
                without = self.drop_effect(best, name)
                if best.scored.done.gain_over(without.scored.done) < least_cost(name, without.scored, self.policy):
                    self.settle_node(without)

    def _search_valves(self, ground: Ground, entry: Entry, tasks: Sequence[Task]) -> None:
        """Find the valves of every kind that is not known yet, on growing parts of the record."""
        asked = [q for t in tasks if kind_of(t.spec) not in self.valves for q in t.for_valves(self.only_noise(entry))]
        with Crew(ground.by_law() if asked else ground, self.jobs) as crew:
            for task, answer in self.budget.answers(crew, asked):
                self.valves[kind_of(task.spec)] = (*self.valves.get(kind_of(task.spec), ()), *answer.valves)

    def _edges(self, spec: Spec) -> list[Task]:
        """The edges of a node whose ends are not fitted in full; `spec` is that of its search form."""
        leak = leaking_process(spec) if self.whole else None
        tasks = [*edges(spec, self.loop, self.only, self.commands), *([Task(leak)] if leak else [])]
        return list(filter(self._needs_fit, tasks))

    def _look_at_tasks(self, ground: Ground, entry: Entry, tasks: Sequence[Task]) -> list[Packed]:
        """Looks at tasks; the best effects by score and by free-run error are polished.

        Effects off the valve come first, then two on it at a time (last those that change along the record: a budget
        that ends leaves them out), then structures. The last two also start from new valves unless noise alone is left.
        """
        tasks = keep_followed_tags(ground, tasks)
        answers: list[Packed] = []
        valves = sorted((t for t in tasks if t.on_valve), key=lambda t: parse(t.added)[0].profile is not None)
        for some in filter(None, ([t for t in tasks if t.added and not t.on_valve],
                                  *(valves[i:i + 2] for i in range(0, len(valves), 2)),
                                  [t for t in tasks if not t.added])):
            little = (self._score_of(a).leaves_little(self.policy) for a in answers if a.added)
            near = entry.scored.like_noise(self.policy) or any(little)
            answers += self._perform_tasks(ground, entry, [
                replace(t, stage=NEAR if near else FAR if t.on_valve else t.stage) for t in some])
        effects = [a for a in answers if a.added and self.memo[key(a.spec)].look is a]
        by_score = sorted(effects, key=lambda a: -self._score_of(a).done.gain_over(entry.scored.done))
        by_free_run = sorted(effects, key=lambda a: self._score_of(a).least_rmse)
        best = {key(a.spec): a for a in (*by_score[:2 * self.policy.finalists], *by_free_run[:self.policy.finalists])}
        again = [Task(a.spec, a.added, CLOSER, a) for a in best.values() if not a.along]
        polished = self._perform_tasks(ground, entry, again)
        closer = {key(a.spec) for a in polished}  # (the budget may end before)
        return [*(a for a in answers if key(a.spec) not in closer), *polished]

    def _perform_tasks(self, ground: Ground, entry: Entry, tasks: Sequence[Task], always: bool = False) -> list[Packed]:
        """Answers to tasks, each put in the memo where it is its node's best; `always` ignores the budget."""
        answers = []
        with Crew(ground, self.jobs) as crew:
            for task, answer in self.budget.answers(crew, tasks, always):
                if answer.failed:
                    self.memo.setdefault(key(task.spec), failed_entry(entry, task, answer))
                    continue
                remember(self.memo, entry, task, answer, answer.score_again(ground.fit))
                answers.append(answer)
        return answers

    def _fit_best_looks(self, ground: Ground, entry: Entry, looks: Sequence[Packed], sure: bool = False) -> None:
        """Fit the best looks in full, and hand their values back."""
        parent, policy = entry.scored.done, self.policy
        answers = {key(a.spec): a for a in looks}
        gains = {name: self._score_of(a).done.gain_over(parent) for name, a in answers.items()}
        explained, known, count, along = None, self.best().scored, 0, parent.model.spec.paths is not None
        best = known.done.gain_over(parent)
        falls = {name: self._score_of(a).error_over(entry.scored, known) for name, a in answers.items()}
        by_score, by_free_run = sorted(answers, key=lambda name: -gains[name]), sorted(answers, key=falls.__getitem__)
        for name in dict.fromkeys([*by_score[:1], *by_free_run[:1], *by_score]):
            answer, error = answers[name], self._score_of(answers[name]).least_rmse
            if explained is not None and error > policy.nearly * explained.rmse:
                continue
            # A path takes up what a lag or a rest explains: bases are compared along paths of their own.
            structural = not depth(answer.spec) and (
                (along and answer.added != "") or better_base(self.memo, self.memo[name]))
            # A disturbance placed roughly has large innovations, but it halves the free-run error.
            halves = name in by_free_run[:policy.finalists] and 2 * falls[name] <= 1
            freer = falls[name] * policy.better_base < 1
            far = gains[name] < best - policy.within and not freer
            late = count and (count >= policy.finalists or gains[name] < 0.0)
            # A look that lowers neither BIC nor the free-run error is not fitted, unless the valve may as well rest.
            least = -policy.within if freer or answer.added == RESTING else 0.0
            if (far or late or gains[name] < least) and not structural and not halves and (count or not sure):
                continue
            # The best look is fitted even after the budget, and so is the one of least free-run error if it halves it.
            done = self._perform_tasks(ground, entry, [Task(answer.spec, answer.added, look=answer)],
                                       always=not count or (halves and name == by_free_run[0]))
            count += not structural
            if done:
                best = max(best, self.memo[name].scored.done.gain_over(parent))
                explained = self.memo[name].scored if self.is_explained(self.memo[name]) else explained
        for child in list(self.memo.values()):
            if child.is_near_noise(key(entry.spec), entry.scored, policy) and not self.is_explained(child):
                self.settle_node(child)
        # Polish the parent from the values of each full child: a wrong basin looks like a missing effect.
        children = [e.scored for e in children_of(self.memo, entry) if e.scored.full
                    and (e.spec.process, e.spec.between) == (entry.spec.process, entry.spec.between)]
        if children:
            entry.scored = from_children(ground, entry.spec, entry.scored, children)

