"""The model of a set of physical effects on a study's base, whatever the way there: the end of `add` and `remove`.

The values come from the looks and full fits of the search, noise is completed anew, and parts that a search put in go
where they are needless. `diagnose --apply` ends in the same functions (selection/run.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..effects import parse
from ..errors import CannotTell, ModelError
from ..fit.adequacy import carrier
from ..fit.noise.completion import complete_quickly
from ..fit.study_steps import open_last_model, with_stated_interval
from ..model.restore import described_segments, rebuild_model
from ..record.loop import Finding, Loop
from ..record.preconditions import swing_of
from ..record.study import Step, Study
from ..selection.decide import Decision, decide_answer, prune_effects
from ..selection.entry import Entry
from ..selection.ladder import order_ladder
from ..selection.node import BASE_EFFECTS, key, physical_effects, plain_name, shapes_process, with_effect
from ..selection.run import Resumed, add_decision, base_of, conclude_study, ladder_of, left_out_finding, rank_candidates
from ..selection.score import is_noise
from ..selection.search import Search
from ..verdict.detectable import detectable_sizes
from ..verdict.from_position import from_position
from ..verdict.judge import judge
from ..verdict.severity import with_controller
from ..verdict.swing import meaning_of
from .support import CODES, support_of

# Rise of the free-run error that three digits show, as a share of it.
_VISIBLE = 1e-3


def judged_anew(loop: Loop, study: Study, seed: int) -> Study:
    """The study with the verdict and the severity of its last model: an effect in the model no longer hides the valve.

    Raises DataError for an abstained study.
    """
    run, fit = open_last_model(loop, study, seed)
    main = study.estimate
    if main is not None:
        position = from_position(run.loop.longest_segment(), law=run.law, s_max=swing_of(run.loop, run.found),
                                 rng=np.random.default_rng(seed), fit=fit)
        main = replace(main, from_position=position)
        fit = with_stated_interval(fit, main)
    verdict = judge(run, fit, loop, main.from_position if main else None, study.steps)
    severity, swing = meaning_of(run.loop, main, fit, verdict) if main else (None, None)
    severity = severity and with_controller(severity, study.controller)
    return replace(study, estimate=main, verdict=verdict, severity=severity, swing=swing)


def with_carrier(study: Study) -> Study:
    """The study with the noise that alone keeps its model from being adequate.

    No noise does so beside a shape of what is missing.
    """
    other = study.adequate is not False or study.unexplained
    return replace(study, carried_by="" if other else carrier(study.steps[-1]))


def with_sizes(loop: Loop, study: Study) -> Study:
    """The study with the smallest size of every effect that was not named which its record would have shown."""
    if not study.candidates:
        return study
    piece, _ = described_segments(loop, study.steps[-1].model)
    names = {c: c.effect + (f"@{c.variant}" if c.variant and c.variant in parse(c.effect)[0].variants else
                            f":{c.variant}" if c.variant else "") for c in study.candidates if not c.accepted}
    have = {parse(name)[0].name for name in study.steps[-1].effects}
    sizes = detectable_sizes([n for c, n in names.items() if c.effect not in have],
                             complete_quickly(*rebuild_model(piece, study.steps[-1].model)))
    return replace(study, candidates=tuple(
        replace(c, detectable_from=sizes.get(names[c])) if c in names else c for c in study.candidates))


def asked_for(study: Study) -> tuple[str, ...]:
    """Effects of the last model that a user asked for: those of the base, and those of steps that were added by hand.

    A step that was added by hand has the finding of its support.
    """
    names = list(study.steps[0].model["effects"])
    for before, step in pairwise(study.steps):
        if any(f.code in CODES for f in step.findings):
            names += _new(before, step)
    return tuple(n for n in dict.fromkeys(names) if n in study.steps[-1].model["effects"])


def entered(on: Resumed, names: Sequence[str], asked: Sequence[str]) -> Entry:
    """The node of the study's model with the best of some variants of one more effect, fitted in full.

    Parts of the base that a search put in may stand for the effect, so it is fitted beside the model without them, too.
    Raises ModelError where no fit converges.
    """
    search, here = on.search, on.here
    effect = parse(names[0])[0]
    found = _beside(search, here, names)
    parts = [n for n in physical_effects(here.spec) if plain_name(n) in BASE_EFFECTS and n not in asked]
    if parts and (found is None or effect.slides or shapes_process(effect) or not search.only_noise(found)):
        bare = here
        for part in parts:
            bare = search.drop_effect(bare, part)
        other = _beside(search, bare, names)
        if other is not None and (found is None or other.scored.done.gain_over(found.scored.done) > 0.0):
            found = other
    if found is None:
        raise ModelError(f"the refit with {names[0]} did not converge",
                         "try another effect; stictionid diagnose ranks them")
    return _elsewhere(search, found, names)


def taken_out(on: Resumed, names: Sequence[str]) -> Entry:
    """The node of the study's model without some effects; a base that was never searched is searched as any other."""
    search, entry = on.search, on.here
    for name in names:
        known = frozenset(search.memo)
        entry = search.drop_effect(entry, name)
        if not physical_effects(entry.spec) and key(entry.spec) not in known:
            with suppress(CannotTell):
                entry = search.root(on.run.fit(entry.spec))
    return entry


def of_effects(loop: Loop, on: Resumed, entry: Entry, *, keep: Sequence[str], asked: Sequence[str], noise: str = "",
               new: Sequence[str] = (), gone: Sequence[str] = ()) -> tuple[Study, Decision]:
    """The study whose last model has the effects of a node, and the decision on it.

    Effects to `keep` stay, other needless ones go. Of those `asked` for each gets its answer. `noise` is a noise model
    chosen by hand. Effects `new` were added by hand now, those `gone` were taken out.
    """
    search, study = on.search, on.study
    entry = _as_it_moved(search, entry)
    stay = {plain_name(name) for name in keep}
    found = decide_answer(search, entry, tuple(n for n in physical_effects(entry.spec) if plain_name(n) in stay))
    if noise or found.noise in map(plain_name, gone):
        found = replace(found, noise=noise)
    before = tuple(dict.fromkeys(n for step in study.steps for n in step.model["effects"] if not is_noise(n)))
    ladder = order_ladder(search, found.winner, base_of(study), before)
    steps, fits = ladder_of(on.run, search, found, on.fit, ladder, study, left_out_finding(found, study, gone))
    rose = rises(study, replace(study, steps=tuple(steps)))
    steps = _answered(on, found, steps, asked, rose)
    after = conclude_study(add_decision(on, study, found), found, steps, fits)
    if study.candidates:
        after = with_sizes(loop, rank_candidates(on, after, found, new))
    return with_carrier(judged_anew(loop, after, search.seed)), found


def with_finding(study: Study, finding: Finding, name: str = "") -> Study:
    """The study with one more finding on the step that added an effect, or on its last one."""
    at = next((i for i, step in enumerate(study.steps) if name and step.added == plain_name(name)),
              len(study.steps) - 1)
    return replace(study, steps=tuple(replace(step, findings=(*step.findings, finding)) if i == at else step
                                      for i, step in enumerate(study.steps)))


def rises(before: Study, after: Study) -> bool:
    """True where the free-run error of the last model is larger than before, as far as three digits show."""
    return after.steps[-1].error.best > (1.0 + _VISIBLE) * before.steps[-1].error.best


def needless(search: Search, found: Decision, newest: str, asked: Sequence[str]) -> tuple[str, ...]:
    """Effects asked for, but the newest one, that a search would leave out of the model."""
    stay = tuple(n for n in physical_effects(found.winner.spec) if plain_name(n) == plain_name(newest))
    needed = prune_effects(search, found.winner, stay)
    have = set(physical_effects(found.winner.spec)) - set(physical_effects(needed.spec))
    return tuple(n for n in asked if n in have)


def _beside(search: Search, entry: Entry, names: Sequence[str]) -> Entry | None:
    """The best node with one of some effects more, one that passes the gates first; None where no fit converged."""
    search.ask_for(entry, names, sure=True)
    nodes = [search.memo.get(key(with_effect(entry.spec, name))) for name in names]
    full = [e for e in nodes if e is not None and e.scored.full]
    return max(full, key=lambda e: (search.memo.passed(e), e.scored.done.gain_over(entry.scored.done)), default=None)


def _elsewhere(search: Search, entry: Entry, newest: Sequence[str]) -> Entry:
    """The node with earlier disturbances entering elsewhere, where that explains more beside the newest one.

    Their place was chosen while the newest effect was missing.
    """
    for name in physical_effects(entry.spec):
        effect, at = parse(name)
        others = [f"{effect.name}@{v}" for v in effect.variants if v != at]
        if name in newest or not others or search.only_noise(entry):
            continue
        other = _beside(search, search.drop_effect(entry, name), others)
        if other is not None and other.scored.done.gain_over(entry.scored.done) >= search.policy.alike:
            entry = other
    return entry


def _as_it_moved(search: Search, entry: Entry) -> Entry:
    """The node under another command between samples, where it leaves more than noise and does worse.

    The motion of the command cannot be seen beside a missing effect. Taken for held, the command leaves a lag of half a
    sample.
    """
    for command in search.commands:
        if command.between != entry.spec.between and not search.only_noise(entry):
            other = search.fit_structure(entry, replace(entry.spec, between=command.between, substeps=command.substeps))
            if other is not None and other.scored.done.gain_over(entry.scored.done) >= search.policy.structure_margin:
                entry = other
    return entry


def _answered(on: Resumed, found: Decision, steps: Sequence[Step], asked: Sequence[str], rose: bool) -> list[Step]:
    """The steps of a ladder, those of effects asked for with the answer of the record."""
    wanted, out = {plain_name(name) for name in asked}, [steps[0]]
    for before, step in pairwise(steps):
        for name in (n for n in _new(before, step) if plain_name(n) in wanted):
            support = support_of(on.search, found.winner, name, rose)
            others = tuple(f for f in step.findings if f.code not in CODES)
            step = replace(step, supported=support.supported, findings=(support.finding, *others))
        out.append(step)
    return out


def _new(before: Step, step: Step) -> list[str]:
    return [n for n in step.model["effects"] if n not in before.model["effects"]]
