"""The search as a study sees it: roots from its steps and its tree, the ladder of the winner, the tree in words.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..effects import catalogue, parse
from ..fit.context import Run
from ..fit.friction_free import follows_command
from ..fit.noise.completion import AUTOREGRESSIVE, Refit, complete_model, place_slips
from ..fit.noise.unexplained import judged_by
from ..fit.points.fitted import Fitted, as_it_stands
from ..fit.rung import Rung, fit_rung, in_colour, noise_finding, step_of, with_levels
from ..fit.starts.intersample import as_moving, surely_moves, surely_scanned
from ..fit.study_steps import open_last_model, widen_to_equivalents, with_known_jump, with_noise_of, with_steps
from ..model.restore import rebuild_model
from ..model.segments import rebind_model
from ..model.spec import Spec
from ..process.scan import parts_of, scans_between_samples
from ..record.loop import Finding, Loop
from ..record.study import Step, Study
from ..record.tree import Edge as TreeEdge
from ..record.tree import TreeNode
from ..typing import FloatArray, Progress
from .bootstrap import p_of
from .decide import Decision, candidates, decide_answer
from .entry import ADD, ROOT, Entry
from .ladder import order_ladder
from .looks import rng_of
from .node import additions, depth, key, node, physical_effects, plain_name, spec_of, structure
from .policy import Policy
from .score import Scored, complete_as_is, complete_fit, is_noise, noise_name, noise_words
from .search import Search

# Statuses of nodes without a full fit.
_LOOKED = ("looked", "failed")

# Gives a study with another last model its verdict and severity.
Judge = Callable[[Loop, Study, int], Study]


@dataclass(frozen=True, slots=True)
class Resumed:
    """A study's last model and tree in a search that goes on from there; `here` is the node of that model.

    `looked` are the nodes of the tree without a full fit; the memo of the search does not hold them.
    """

    study: Study
    run: Run
    fit: Fitted
    search: Search
    here: Entry
    looked: tuple[Entry, ...]


def select(loop: Loop, study: Study, judge: Judge, *, everything: bool = False, apply: bool = False, seed: int = 0,
           jobs: int = 1, bootstrap: int = 0, policy: Policy | None = None, progress: Progress | None = None) -> Study:
    """The study with its tree, ranked candidates and the effect to add next; with `apply` with all that were found.

    `everything` expands the best node even where it leaves only noise. `jobs` processes share the looks and fits.
    `bootstrap` replicates give the effect to add next a p-value; above the policy's chance nothing is named.
    `judge` gives a study whose last model, or whose interval, is another than before its verdict and severity. Raises
    DataError for an abstained study, and for one that can't be rebuilt.
    """
    tell = progress or (lambda text, share: None)
    on = resume_search(loop, study, seed=seed, jobs=jobs, policy=policy, progress=tell)
    run, fit, search, here = on.run, on.fit, on.search, on.here
    if study.verdict.stiction != "stiction" and not (everything or search.at_end(here)) and follows_command(run, fit):
        search.only = frozenset(e.name for e in catalogue().values() if e.friction is None)
    found = decide_answer(search, search.run(everything=everything), spans=run.options.intervals, further=True)
    before = physical_effects(here.spec)
    order, rungs = order_ladder(search, found.winner, base_of(study))
    new = tuple(name for name in order if name not in before)
    if found.noise and not any(plain_name(n) == found.noise for n in fit.model.spec.effects):
        new = (*new, found.noise)
    p_value = None
    if bootstrap and new and not is_noise(new[0]):
        p_value = p_of(search, here, new[0], bootstrap, tell)
    chance = p_value is not None and p_value > max(search.policy.chance, 1.0 / (bootstrap + 1))
    if chance:
        new = ()
    study = add_decision(on, study, found)
    # (a better fit of the same model is taken where the valve sticks: it must not settle a verdict that is open)
    better = study.verdict.stiction == "stiction" and \
        found.winner.scored.done.gain_over(complete_fit(fit)) > search.policy.alike
    changed = not chance and (new or set(before) - set(order) or key(here.spec) != key(found.winner.spec) or better)
    if changed and apply:
        tell("fitting the ladder", 1.0)
        study = conclude_study(study, found, *ladder_of(run, search, found, fit, (order, rungs), study,
                                                        left_out_finding(found, study)))
    study = rank_candidates(on, study, found, new, "may be chance" if chance else "", p_value)
    if chance:
        return study
    missing = tuple(dict.fromkeys(parse(name)[0].name for name in new))
    if changed:
        return replace(judge(loop, study, seed), missing=missing) if apply else replace(study, missing=missing[:1])
    after = _widen_estimate(study, found)
    return after if after.estimate == study.estimate else judge(loop, after, seed)


def resume_search(loop: Loop, study: Study, *, seed: int, jobs: int = 1, policy: Policy | None = None,
                  progress: Progress | None = None) -> Resumed:
    """A study's last model and its tree in a search that goes on from there; DataError for an abstained study."""
    run, fit = open_last_model(loop, study, seed)
    policy = policy or Policy()
    search = search_of(run, policy, progress or (lambda text, share: None), seed=seed, jobs=jobs)
    search.may_place = not (study.tree and search.slow)  # (`identify` asked where the record hides scans)
    looked = _replant(search, run, study, fit, policy)
    return Resumed(study, run, fit, search, search.memo[key(node(fit.model.spec))], looked)


def search_of(run: Run, policy: Policy, tell: Progress, *, seed: int, jobs: int = 1,
              only: frozenset[str] | None = None) -> Search:
    """A search without nodes over the models of a run's record, with what the record says about its scans.

    Scans between the samples blur the output, unless it is smooth by itself.
    """
    slow = scans_between_samples(run.loop, run.options.scan_s)
    scans = parts_of(run.loop.step_s, run.options.scan_s) if slow and run.options.between == "auto" else 1
    return Search(run.loop, policy, seed, jobs, tell, only=only, commands=commands_of(run), slow=slow, scans=scans,
                  blurred=slow and not surely_moves(run.loop), floor=floor_of(run))


def add_decision(on: Resumed, study: Study, found: Decision) -> Study:
    """The study with the tree, the equivalents and the missing effects of a decision; its model stays."""
    search = on.search
    for entry in on.looked:
        search.memo.setdefault(key(entry.spec), entry)
    if key(on.here.spec) != key(found.winner.spec):
        study = with_noise_of(study, found.winner.scored.done)
    return replace(study, tree=tree_of(search, found),
                   evaluations=search.budget.counted + (study.evaluations or 0),
                   unasked=tuple(search.budget.unasked), equivalents=found.equivalents,
                   missing_reason=found.missing_reason, unexplained=found.shape, missing=())


def rank_candidates(on: Resumed, study: Study, found: Decision, named: Sequence[str], doubt: str = "",
                    p_value: float | None = None) -> Study:
    """The study with its ranking, a p-value in the first statement; nodes that are steps have the errors of the step.
    """
    errors = {key(rebuild_model(on.run.loop, step.model)[0].spec): step.error for step in study.steps}
    rows = candidates(on.search, found, named, study, errors, doubt)
    if p_value is not None and rows:
        rows = (replace(rows[0], statement=f"{rows[0].statement}; bootstrap p = {p_value:.3g}"), *rows[1:])
    return replace(study, candidates=rows)


def conclude_study(study: Study, found: Decision, steps: Sequence[Step], fits: Sequence[Fitted]) -> Study:
    """The study with the ladder of a decision; search, `add` and `remove` end here, so that they agree."""
    after = _widen_estimate(with_steps(study, tuple(steps), fits[-1]), found)
    adequate, why = judged_by(found.shape, after.adequate, after.adequate_reason)
    return replace(after, adequate=adequate, adequate_reason=why)


def _widen_estimate(study: Study, found: Decision) -> Study:
    """The study with intervals of S and J widened to those of the equivalents."""
    estimate = study.estimate
    if estimate is None:
        return study
    reaching = widen_to_equivalents(estimate, found.reach)
    return replace(study, estimate=with_known_jump(reaching, found.winner.scored.done.model.loop, study.steps))


def floor_of(run: Run) -> Callable[[Refit], float | None]:
    """The irreducible noise of a record for a completed model, its known disturbances left out."""
    def floor(done: Refit) -> float | None:
        e, model = done.evaluated, done.model
        known = model.disturbance(done.values, e.own) if any(x.columns for x in model.effects) else None
        return run.floor(e.position_means, e.values["dead_time_s"], known)

    return floor


def commands_of(run: Run) -> tuple[Spec, ...]:
    """The possible courses of the command between samples; none where the record shows it."""
    if run.options.between != "auto" or surely_moves(run.loop) or surely_scanned(run.loop):
        return ()
    return Spec(), as_moving(Spec())


def _replant(search: Search, run: Run, study: Study, fit: Fitted, policy: Policy) -> tuple[Entry, ...]:
    """Put the models of a study's steps and of its tree in the memo of a search.

    Nodes with effects that only had a look, and those that failed, are returned instead: in the memo the search would
    not look at them again. Bases that only had a look are put in the memo, so they are not looked at again.
    """
    search.root(fit)
    looked: list[Entry] = []
    specs = {n.id: spec_of(n.structure, n.effects, fit.model.spec) for n in study.tree}
    children: dict[int, set[str]] = {}
    for n in study.tree:
        if n.parent is not None and n.edge.op == ADD:
            children.setdefault(n.parent, set()).add(n.edge.what)
    own, failed = key(node(fit.model.spec)), complete_fit(fit)
    for n in study.tree:
        full = n.status not in _LOOKED
        if full and not n.parameters:
            continue
        spec, done = specs[n.id], failed
        if n.parameters:
            # (a tree keeps parameters only; the slips that PV placed stand in the study's last model)
            along = replace(spec, paths=fit.model.spec.paths) if key(spec) == own else spec
            model = rebind_model(fit.model, along, fit.best.left)
            done = complete_as_is(model, model.vector(n.parameters))
            if n.status == "equivalent":
                done = place_slips(done)  # (else it would be worse for want of its slips, and none any more)
        entry = Entry(spec, Scored(done, full), None if n.parent not in specs else key(specs[n.parent]), n.edge.op,
                      n.edge.what, gates=n.gates, stands_in=full and not n.gates,
                      failed=n.gates[0].reason if n.status == "failed" and n.gates else "")
        if not full and (depth(spec) or entry.failed or not n.parameters):
            looked.append(entry)
            continue
        # Another search may have asked for fewer effects.
        entry.asked = set(additions(spec, search.loop, search.only)) <= children.get(n.id, set())
        have = search.memo.get(key(spec))
        if have is None:
            search.memo[key(spec)] = entry
            continue
        have.asked = entry.asked
        if done.gain_over(have.scored.done) > policy.better_fit:
            have.scored = entry.scored
    for step in study.steps[:-1]:
        model, values = rebuild_model(run.loop, step.model)
        spec = node(model.spec)
        if key(spec) not in search.memo:
            there = rebind_model(fit.model, spec, fit.best.left)
            search.root(as_it_stands(there, there.vector(model.named(values))))
    here = search.memo[own]
    if study.tree:  # (the search that made it refitted its answer, and moved all slips of it)
        here.settled, here.moved = True, here.scored
    for entry in search.memo.values():
        search.memo.gates(entry)  # (those of the tree compared its own fits, not better ones that follow)
    return tuple(looked)


def ladder_of(run: Run, search: Search, found: Decision, first: Fitted, ladder: tuple[tuple[str, ...], list[Rung]],
              study: Study | None = None, said: tuple[Finding, ...] = ()) -> tuple[list[Step], list[Fitted]]:
    """The steps of a decision from the base up and their fits; `ladder` holds the effects in their order and the rungs.

    Steps of a `study` stay as far as they are rungs; their fits are then left out. A base that is the `first` fit
    keeps its restarts. The last step gets the findings that are to be `said`.
    """
    order, rungs = ladder
    steps: list[Step] = []
    fits: list[Fitted] = []
    for i, (name, (spec, values)) in enumerate(zip((None, *order), rungs, strict=True)):
        final = i == len(order) and not found.noise
        if study is not None and not fits and not final and i < len(study.steps) \
                and _is_rung(run, study.steps[i], spec):
            steps.append(study.steps[i])
            continue
        searched = study is None and key(first.model.spec) == key(spec) \
            and _as_good(first, run, spec, values, search.policy.neutral)
        values, full = first.values if searched else values, spec
        if final and not run.options.base_only:
            full, values = in_colour(run.model(spec), values, found.winner.scored.done)
        more = said if final else ()
        if searched and full.taps == first.model.spec.taps:
            fits.append(first)
            steps.append(run.step(first, name))
            continue
        fit = fit_rung(run.model(full), values, rng_of(search.seed, key(spec), 2), last=final,
                       spans=run.options.intervals)
        if final and study is not None:
            fit = with_levels(run, fit, rng_of(search.seed, key(spec), 1))
        if full.taps != spec.taps:
            more = (*more, noise_finding(fit))
        if searched:
            fit = replace(fit, runs=first.runs, agree=first.agree, searched=first.searched)
            step = run.step_again(run.step(first, name), fit)
        else:
            step = step_of(run, fit, name)
        steps.append(replace(step, findings=(*step.findings, *more)))
        fits.append(fit)
    if found.noise:
        rng = rng_of(search.seed, found.noise, 2)
        done = found.winner.scored.done
        if found.noise != noise_name(found.winner.scored, search.policy, slow=search.slow):
            # A user chose it.
            done = complete_model(done.model, done.values, None, rng,
                                  noise=parse(found.noise)[0].noise or AUTOREGRESSIVE)
        full = replace(done.spec, effects=(*physical_effects(found.winner.spec), found.noise))
        model = rebind_model(done.model, full, done.evaluated.left)
        fits.append(fit_rung(model, model.vector(done.model.named(done.values)), rng, last=True,
                             spans=run.options.intervals))
        steps.append(step_of(run, fits[-1], found.noise, (*said, noise_finding(fits[-1], found.rival))))
    return steps, fits


def base_of(study: Study) -> tuple[str, ...]:
    """The effects that a study's base has."""
    return tuple(name for name in study.steps[0].model.get("effects", ()) if not is_noise(name))


def _as_good(first: Fitted, run: Run, spec: Spec, values: FloatArray, neutral: float) -> bool:
    """True where a fit that was searched with restarts is as good as a rung, or of the same valve."""
    model = run.model(spec)
    return first.model.spec == model.spec and bool(
        first.sse <= model.costs_of(values[:, None])[0] * (1.0 + neutral))


def _is_rung(run: Run, step: Step, spec: Spec) -> bool:
    """True where a step of the study is this node without a noise model."""
    if not step.model:
        return False
    model, _ = rebuild_model(run.loop, step.model)
    return key(model.spec) == key(spec) and len(model.spec.effects) == len(physical_effects(model.spec))


def left_out_finding(found: Decision, study: Study, but: Sequence[str] = ()) -> tuple[Finding, ...]:
    """The finding on effects of the study that the ladder leaves out, other than those taken out by hand (`but`)."""
    had = {plain_name(name) for name in study.steps[-1].effects}
    have = {plain_name(name) for name in physical_effects(found.winner.spec)} | ({found.noise} - {""})
    gone, new = sorted(had - have - {plain_name(name) for name in but}), sorted(have - had)
    if not gone:
        return ()
    beside = f"beside {', '.join(new)}" if new else "now"
    return (Finding("gave-way", "info", f"left out: {', '.join(gone)}, needless {beside}", {"effects": gone},
                    tuple(new), "Kass and Raftery 1995"),)


def tree_of(search: Search, found: Decision) -> tuple[TreeNode, ...]:
    """Every model that a search tried, as a study keeps it."""
    ids = {name: i for i, name in enumerate(search.memo)}
    alike = {e.node for e in found.equivalents}
    winner = set(physical_effects(found.winner.spec))
    out = []
    for name, e in search.memo.items():
        done = e.scored.done
        path = e is found.winner or (e.asked and set(physical_effects(e.spec)) < winner
                                     and e.spec.process == found.winner.spec.process)
        status = ("failed" if e.failed else "named" if path and search.memo.passed(e) else "equivalent"
                  if ids[name] in alike else "expanded" if e.asked else "rejected" if e.scored.full else "looked")
        parent = ids.get(e.parent or "") if e.op != ROOT else None
        known = TreeNode(ids[name], parent, TreeEdge(e.op, e.what), tuple(e.spec.effects), structure(e.spec),
                         noise_words(done), {}, None, None, None, status, search.memo.gates(e))
        out.append(known if e.failed else replace(
            known, parameters=done.evaluated.values, rmse=e.scored.rmse, rmse_one_step=done.innovation_sd,
            bic=done.bic(done.good)))
    return tuple(out)


