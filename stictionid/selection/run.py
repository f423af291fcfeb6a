"""The verb: ranked candidates, the effect to add next, and with `apply` one after the other until none is accepted.

Every candidate is completed with the noise its residual asks for and compared by the innovations of the complete model
on the same samples. Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import noises_in, parse
from ..fit.add_effect import polished
from ..fit.context import ADEQUATE
from ..fit.noise.completion import RANDOM_WALK, Refit, at_noise, quick
from ..fit.starts.beside_effect import RESTING
from ..model.restore import rebuild_model
from ..model.spec import INTEGRATOR, Spec
from ..record.loop import Finding, Loop
from ..record.segments import described
from ..record.study import Candidate, Study
from ..typing import Progress
from .judge import ALIKE, HALVED, candidates, halves
from .policy import Policy
from .rounding import moved_by_rounding, step_of
from .rounds import Looked, Onward, beside_lag, look_at, may_go_on, on_every_base, on_other_base, other_structure
from .steps import extended, finished_step, opened, with_steps
from .structure import LAG
from .tries import NAMED, Tried

# Gives a study with another last model its verdict and severity; the seed is that of the walk.
Judge = Callable[[Loop, Study, int], Study]
MOST_ADDITIONS = 4
# Bootstrap p above which nothing is named (CRITICISM.md section 7, step 7), or above the least that so few replicates
# can give.
_CHANCE = 0.01
# Beside noise models: what `identify` may add by itself, without a look at the rivals (methods/auto.py).
_CHOSEN = frozenset({LAG, RESTING})
# Additions before which a round is made beside a lag, too: each costs as much as the round itself.
_JOINTLY = 2
# Candidates of the first round that are asked what comes after them, where the walk from its winner ends with more than
# noise, or after more additions than the second number; each leaves at most the third share of the free-run error.
_OTHER_WAYS, _PAIR, _LEFT = 2, 2, 0.9
# A free-run error within so many times the noise and what rounding moves y by may be rounding: it holds for whole
# strokes, few of them, and a fit that follows the wrong ones errs further (1.1 and 2.3 times met in clean loops).
_BLURRED = 3.0
# BIC by which two effects must be ahead of that end where they don't bring the free run to the noise themselves.
_FAR = 50.0


def select(loop: Loop, study: Study, judge: Judge, *, everything: bool = False, apply: bool = False, seed: int = 0,
         jobs: int = 1, bootstrap: int = 0, policy: Policy | None = None, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; with `apply` added, and so on until none helps.

    An adequate model is left alone unless `everything` asks for the catalogue, its errors still remember, or
    `identify` made it so by a step of its own: that has to stand against the catalogue first.
    `jobs` processes share the refits; `bootstrap` replicates give the named effect a p-value. None of the walk's
    numbers is a field of `policy` yet. `judge` gives a study whose last model is another than before its verdict and
    severity. Raises DataError for an abstained study, and for one that can't be rebuilt.
    """
    return _walked(loop, study, [], (), _Asked(everything, apply, seed, jobs, bootstrap,
                                               progress or (lambda text, share: None), judge))


@dataclass(frozen=True, slots=True)
class _Asked:
    """How a walk was asked for."""

    everything: bool
    apply: bool
    seed: int
    jobs: int
    bootstrap: int
    tell: Progress
    judge: Judge
    # Whether other ways may be tried where the walk does not end in noise.
    detours: bool = True


@dataclass(frozen=True, slots=True)
class _Fork:
    """Where a walk chose its first effect: the study that the round was made on, what was added to it before, and the
    round itself."""

    study: Study
    added: tuple[str, ...]
    looked: Looked


def _walked(loop: Loop, study: Study, added: Sequence[str], ranking: tuple[Candidate, ...], asked: _Asked,
            upcoming: Looked | None = None) -> Study:
    """The walk from a study to which effects were `added` already; `ranking` is that of the last of them, `upcoming`
    the round on the study where it was made."""
    added, turns = list(added), len(added)
    fork: _Fork | None = None
    apply, seed, jobs, bootstrap, tell = asked.apply, asked.seed, asked.jobs, asked.bootstrap, asked.tell
    while True:
        earlier = () if added else before_chosen(study)
        settled = bool(study.steps) and bool(study.adequate) and not _carried(study) and not _memory(loop, study, seed)
        # What was added may hide what else is missing: its innovations tell, however small the error.
        # (Beside a walk that was added last they don't: a valve that is wrong under it leaves what passes every test.)
        more = bool(study.steps) and (bool(added) or _noisy(study)) and (_walks(study) or not _last(loop, study).white)
        if more and not earlier:
            settled = False
        if settled and not earlier and not asked.everything:
            study = replace(study, candidates=() if not added else study.candidates, missing=_kept(added, study))
            return _other_way(loop, study, fork, asked) if fork else study
        if study.steps and not (settled or asked.everything or bootstrap) and (blur := _rounded(loop, study, seed)):
            # What rounding makes of a right model no effect explains to the noise, nor by half; a missing one does.
            upcoming = look_at(loop, study, seed, jobs, tell) if upcoming is None else upcoming
            if not (upcoming.settled or upcoming.white or upcoming.halved):
                return _left_to_rounding(study, upcoming, added, blur)
        chosen = _instead(loop, study, earlier, settled, asked) if earlier else None
        if chosen is not None and chosen.stays and (settled or _noisy(study)):
            # What was chosen stays: what it could hide does no better.
            kept = tuple(c for c in candidates(chosen.found, chosen.winner) if c.effect not in study.steps[-1].effects)
            fork = _Fork(chosen.study, (), chosen)
            study = replace(study, candidates=kept, missing=())
            chosen = _beside_noise(loop, study, asked) if more and _noisy(study) else None
            if chosen is None:
                return _other_way(loop, study, fork, asked) if apply else study
        elif chosen is not None and chosen.followed is not None and apply and not bootstrap:
            return chosen.followed
        if chosen is None or chosen.stays:
            chosen = look_at(loop, study, seed, jobs, tell) if upcoming is None else upcoming
            chosen = _onward(loop, study, chosen, asked)
            # (A valve that does not stick has no effect for a lag to hide, if noise is all that is left.)
            lag = len(added) < _JOINTLY and (study.verdict.stiction != "no stiction" or not chosen.best.white)
            if not _ends(chosen, added):
                chosen = on_every_base(chosen, seed, jobs, tell, rest=not added, lag=lag)
        found, winner, onward = chosen.found, chosen.winner, chosen.next
        study, first = (onward.began, list(onward.first)) if onward else _put_right(loop, study, chosen, asked)
        added, turns = added + first, turns + len(first)
        p_value = None
        if bootstrap and winner is not None:
            from .bootstrap import p_of

            p_value = p_of(found, winner, bootstrap, seed, jobs, tell)
            if p_value > max(_CHANCE, 1.0 / (bootstrap + 1)) + 1e-12:
                # As many records without it would have shown as much: nothing is named.
                study = replace(study, candidates=candidates(found, None, p_value), missing=())
                return replace(study, missing=_kept(added, study)) if apply else study
        study = replace(study, candidates=candidates(found, winner, p_value),
                        missing=(parse(winner.name)[0].name,) if winner else ())
        if not apply or winner is None or turns >= MOST_ADDITIONS:
            if not apply:
                return study
            # The last ranking that named something stays, with its equivalents.
            study = replace(study, missing=_kept(added, study), candidates=ranking or study.candidates)
            fork = fork or _Fork(study, tuple(added), chosen)
            return _other_way(loop, study, fork, asked)
        fork = fork or _Fork(study, tuple(added), chosen)
        ranking = study.candidates
        study = onward.study if onward else _one_more(loop, study, winner, asked)
        upcoming = onward.looked if onward else None
        turns += 1
        # What the newest made superfluous is gone, and missing no more.
        added = [*_kept((*added, parse(winner.name)[0].name), study)]


def _onward(loop: Loop, study: Study, looked: Looked, asked: _Asked) -> Looked:
    """A round on a study, or on what it was before, with what adding its winner comes to where that may be enough."""
    if not asked.apply or asked.bootstrap:
        return looked
    looked = may_go_on(looked, asked.tell)
    if looked.bases != () or looked.winner is None:
        return looked
    began, first = _put_right(loop, study, looked, asked)
    began = replace(began, candidates=candidates(looked.found, looked.winner))
    after = _one_more(loop, began, looked.winner, asked)
    then = look_at(loop, after, asked.seed, asked.jobs, asked.tell)
    return replace(looked, onward=Onward(looked.found, began, tuple(first), after, then))


def _ends(looked: Looked, added: Sequence[str]) -> bool:
    """Whether a round's winner, and what the round after it names, leave nothing but noise: another base could do no
    better. Not where they would be more effects beside those `added` than are believed without a look at the others."""
    onward = looked.next
    if onward is None or looked.winner is None or onward.looked.winner is None:
        return False
    names = {*added, *onward.first, *(parse(t.name)[0].name for t in (looked.winner, onward.looked.winner))}
    return onward.looked.settled and onward.looked.best.white and len(names - _CHOSEN) <= _PAIR


def _beside_noise(loop: Loop, study: Study, asked: _Asked) -> Looked | None:
    """A round beside the noise model that a study ends in, whose innovations are not noise; None where nothing wins."""
    looked = look_at(loop, study, asked.seed, asked.jobs, asked.tell)
    if study.verdict.stiction != "no stiction":
        looked = beside_lag(looked, asked.seed, asked.jobs, asked.tell)
    return looked if looked.winner is not None else None


def _other_way(loop: Loop, study: Study, fork: _Fork, asked: _Asked) -> Study:
    """The study that a walk ended in, or one from another effect of its first round, or of the same round on another
    base, where that ends in noise.

    Of two missing effects the one that helps most by itself may be neither: a sine at a harmonic of the true one, a
    noise model that imitates both. Each is what it is only beside the other.
    """
    if not asked.detours or asked.bootstrap:
        return study
    last = _last(loop, study)
    ended = last.noise_alone or last.walk_alone or at_noise(last)
    # A noise that remembers for long may be a disturbance; beside physics the tests see what another way would need.
    if _noisy(study) and len(noises_in(study.missing)) < len(study.missing):
        ended = ended or last.white
    # (A lag, or a valve that rests, is what `identify` would have added beside the two.)
    if ended and len(set(study.missing) - _CHOSEN) <= _PAIR:
        return study
    seed, jobs, tell = asked.seed, asked.jobs, asked.tell
    ways = [(looked, t) for looked in (fork.looked, *fork.looked.others) for t in _rivals(looked, fork.looked)]
    for looked, t in ways[:_OTHER_WAYS]:
        began, own = fork.study, looked is fork.looked
        if not own:
            assert t.refit is not None
            said = other_structure(fork.looked.found.fit, looked.found.fit, (t.name,), t.refit)
            began, _ = _put_right(loop, began, replace(looked, winner=t, notes=(said,)), asked)
        began = extended(loop, began, t.name, seed=seed, known=t.refit, progress=tell)
        after = look_at(loop, began, seed, jobs, tell, last.innovation_sd)
        after = on_other_base(after, seed, jobs, tell) if own else after
        winner = after.winner
        # Two effects against what one, or a noise model, left: they must be far better.
        if winner is None or winner.noise or after.best.gain_over(last) < (NAMED if after.settled else _FAR):
            continue
        if after.found.better or after.notes:
            began, _ = _put_right(loop, began, after, asked)
        began = replace(began, candidates=candidates(after.found, winner))
        names = [*fork.added, *(parse(n.name)[0].name for n in (t, winner))]
        other = _walked(loop, _one_more(loop, began, winner, asked), names, began.candidates,
                        replace(asked, detours=False))
        if _between(loop, other, study) >= NAMED:
            return other
    return study


def _rivals(looked: Looked, first: Looked) -> list[Tried]:
    """Physical candidates of a round that may be one of two, best first: each leaves clearly less in the free run, and
    is ahead of a noise model where one won; no worse will do where it halves the free run, as no noise model can."""
    found, won = looked.found, looked.winner if looked is first else None
    rival = found.noise_gain if won is None or won.noise else 0.0
    rivals = [t for t in found.tried if t is not won and not t.noise and t.full and t.refit is not None
              and t.refit.evaluated.rmse <= _LEFT * found.reference.evaluated.rmse
              and t.delta_bic >= max(NAMED, rival + (-ALIKE if halves(t, found) else NAMED))]
    return sorted(rivals, key=lambda t: t.refit.evaluated.rmse if t.refit else np.inf)


def _put_right(loop: Loop, study: Study, chosen: Looked, asked: _Asked) -> tuple[Study, list[str]]:
    """The study that a round was made on, its last step put right, and what it added: a lag, a rest, or a walk; as it
    is where the round found nothing wrong with it."""
    if chosen.study is study and not chosen.found.better and not chosen.notes:
        return study, []
    before, after = ([step.added for step in s.steps if step.added] for s in (study, chosen.study))
    gone = [name for name in before if name not in after]
    first = [parse(name)[0].name for name in after if name not in before]
    return asked.judge(loop, _replaced(chosen, gone), asked.seed), first


def _one_more(loop: Loop, study: Study, winner: Tried, asked: _Asked) -> Study:
    """The study with a round's winner, and with the verdict and the ranking that go with it.

    What an addition makes superfluous goes (CRITICISM.md section 7, step 8); a finding of the step says so.
    """
    after = extended(loop, study, winner.name, seed=asked.seed, prune=True, known=winner.refit, progress=asked.tell)
    if not winner.noise:
        after = without_noise(loop, after, winner.name, asked.seed)
    return replace(asked.judge(loop, after, asked.seed), candidates=study.candidates)


def _kept(added: Sequence[str], study: Study) -> tuple[str, ...]:
    """What was added to a study and is in it still: what a later effect made superfluous is not missing."""
    have = {parse(name)[0].name for name in study.steps[-1].effects}
    return tuple(name for name in added if name in have)


def without_noise(loop: Loop, study: Study, name: str, seed: int) -> Study:
    """The study without the noise model that its last effect, `name`, was found beside, where that leaves but half of
    the free-run error that the noise model was taken for.

    It had imitated what is physical, and what is still to come; what it is good for now the next round tells. A step
    just before that added nothing else is gone, too: the ladder does not climb by what is not there.
    """
    last = study.steps[-1]
    plain = next((s for s in reversed(study.steps) if not noises_in(s.effects)), None)
    if not _noisy(study) or plain is None:
        return study
    noises = noises_in(last.effects)
    named = next(s for s in study.steps if set(noises) & set(s.effects))
    run, fit = opened(loop, study, seed)
    # (A first order has levels without a noise model; how an integrator was fitted the step without it knows.)
    before = rebuild_model(run.loop, plain.model)[0].spec if fit.model.spec.process == INTEGRATOR else Spec()
    spec = replace(fit.model.spec, effects=tuple(n for n in fit.model.spec.effects if n not in noises),
                   increments=before.increments, taps=before.taps)
    model = run.model(spec)
    after = polished(model, model.vector(fit.model.named(fit.values)), run.rng)
    if after.best.rmse > HALVED * named.error.rmse:
        return study
    # (Where it leaves white innovations, and the model without it does not leave noise, it is needed.)
    if _last(loop, study).white and not at_noise(quick(model, after.values)):
        return study
    said = Finding("gave-way", "info",
                   f"left out again, because {name} explains what it had imitated: {', '.join(noises)}",
                   {"effects": list(noises), "instead": name}, (parse(name)[0].name,), "CRITICISM.md section 7, step 8")
    step = finished_step(run, after, last.added, (*last.findings, said))
    earlier = study.steps[:-1]
    if earlier[-1].added in {parse(n)[0].name for n in noises}:
        earlier = earlier[:-1]
    return with_steps(study, run, (*earlier, replace(step, variant=last.variant)), after)


def before_chosen(study: Study) -> tuple[Study, ...]:
    """The study as it was before the last step that `identify` added by itself, the first noise, and all of them.

    Empty where it added none, or the user did. An autoregression can imitate anything one step ahead, and a valve that
    rests, or a lag, much: what was chosen before any rival was tried has to stand against the whole catalogue first.
    """
    names = [step.added or "" for step in study.steps[1:]]
    noises = noises_in(names) if all(names) else ()
    if not names or not all(n in _CHOSEN or n in noises for n in names):
        return ()
    first = [names.index(n) + 1 for n in noises[:1]]
    parts = [replace(study, steps=study.steps[:k]) for k in sorted({len(names), *first, 1}, reverse=True)]
    # Beside a noise model everything is small; and where nothing of y is explained nothing can be missing.
    return tuple(part for part in parts if not _noisy(part) and not _nothing(part))


def _nothing(study: Study) -> bool:
    """Whether a study's last model runs freely no better than a constant, and a walk was taken because of that."""
    fitted = study.steps[-1].error.fit_percent
    return fitted is not None and fitted <= 0.0


def _memory(loop: Loop, study: Study, seed: int) -> bool:
    """Whether the errors of a study's model without a noise model remember: what is left is small, but not noise.

    An error within a few per cent of the noise may still hold an effect that 1500 samples show beyond doubt.
    """
    if _noisy(study):
        return False
    _, fit = opened(loop, study, seed)
    white, coloured = quick(fit.model, fit.values, order=0), quick(fit.model, fit.values)
    return coloured.gain_over(white) > NAMED


def _rounded(loop: Loop, study: Study, seed: int) -> float:
    """How far the rounding of the recorded output moves y of a study's last model, where that may be all that its free
    run leaves beyond noise; 0 where it is not."""
    last = study.steps[-1]
    blur, floor = moved_by_rounding(loop, last.model, seed), last.error.noise_sd
    return blur if floor is not None and last.error.rmse <= _BLURRED * float(np.hypot(floor, blur)) else 0.0


def _left_to_rounding(study: Study, looked: Looked, added: Sequence[str], blur: float) -> Study:
    """The study whose errors may all be the rounding of its output: nothing more is named, and the reason says so."""
    last, step = study.steps[-1], step_of(looked.run.loop.output)
    why = (f"the free-run error {last.error.rmse:.4g} may be no more than rounding: the output is recorded in steps of "
           f"{step:.3g} %, which moves the model's process value by {blur:.3g} beside the noise, and no effect brings "
           "the error to the noise, or halves it; export the output with more digits")
    said = Finding("rounded-output", "warning", why, {"moved_by_rounding": blur, "rmse": last.error.rmse})
    last = replace(last, findings=(*(f for f in last.findings if f.code != said.code), said))
    ranked = study.candidates if added else candidates(looked.found, None)
    return replace(study, steps=(*study.steps[:-1], last), candidates=ranked, missing=_kept(added, study),
                   adequate_reason=why)


def _noisy(study: Study) -> bool:
    return bool(noises_in(study.steps[-1].effects))


def _walks(study: Study) -> bool:
    """Whether a random walk is the last that a study added."""
    added = study.steps[-1].added
    return added is not None and parse(added)[0].noise == RANDOM_WALK


def _carried(study: Study) -> bool:
    """Whether only the form in which an integrator is fitted makes it adequate: its free run is not at the noise.

    Changes of y show the valve, but hide in white noise whatever is slow.
    """
    last = study.steps[-1]
    floor = last.error.noise_sd
    return bool(last.model.get("increments")) and not _noisy(study) and floor is not None \
        and last.error.rmse > ADEQUATE * floor


def _instead(loop: Loop, study: Study, before: Sequence[Study], settled: bool, asked: _Asked) -> Looked | None:
    """What explains the record better than the steps that `identify` chose; None where the study's own round decides.

    The last of the steps stands first, beside the others: a valve that rests at every scan hides what a lag imitates.
    `stays` where the study is adequate and nothing does better; `followed` where the answer had to be walked to.
    """
    seed, jobs, tell = asked.seed, asked.jobs, asked.tell
    alone = settled and _last(loop, study).noise_alone
    v = study.steps[-1].model["values"]
    carried = (v["S"], v["J"]) if _noisy(study) else None
    best: tuple[float, Looked] | None = None
    known: set[str] = set()
    for earlier in before:
        looked = look_at(loop, earlier, seed, jobs, tell)
        # (A model in changes of y does not know; the round completed it in levels.)
        won = looked.winner
        alone = alone or (settled and looked.white and won is not None and _has(study, won))
        # Where the whole catalogue names the very step, and its steps leave noise as it is, no other base is asked; nor
        # where they leave noise that no test tells from chance.
        if not (settled and (alone or (_confirms(looked, study) and not _noisy(study)))):
            # What `identify` found itself had its round, with fresh basins of its own, when that step was looked at.
            looked = _onward(loop, study, looked, asked)
            if _ends(looked, ()) and _between(loop, followed := _followed(loop, study, looked, asked), study) >= NAMED:
                return replace(looked, followed=followed)
            looked = on_every_base(looked, seed, jobs, tell, rest=RESTING not in known, lag=LAG not in known,
                                   carried=carried)
        known |= set(earlier.steps[-1].effects)
        ahead = _ahead(looked, study)
        if best is None or ahead >= best[0]:
            best = ahead, looked
        if ahead >= NAMED and looked.settled:
            break
    assert best is not None
    ahead, looked = best
    if ahead < NAMED and _may_lead_further(looked, before, study) and not (alone and _confirms(looked, study)):
        # One effect against several steps: what the round names is followed to its end before it is judged.
        followed = _followed(loop, study, looked, replace(asked, apply=True, bootstrap=0))
        ahead = _between(loop, followed, study)
        if ahead >= NAMED:
            looked = replace(looked, followed=followed)
    if study.adequate:
        return replace(looked, stays=ahead < NAMED)
    if ahead < NAMED:
        return None
    own = look_at(loop, study, seed, jobs, tell)
    if own.winner is None or own.winner.refit is None or looked.winner is None or looked.winner.refit is None:
        return looked
    return looked if looked.winner.refit.gain_over(own.winner.refit) > 0.0 else own


def _followed(loop: Loop, study: Study, looked: Looked, asked: _Asked) -> Study:
    """What a walk from a round's winner ends in."""
    winner, onward = looked.winner, looked.next
    assert winner is not None
    if onward is None:
        began, first = _put_right(loop, study, looked, asked)
        began = replace(began, candidates=candidates(looked.found, winner))
        after, upcoming = _one_more(loop, began, winner, asked), None
    else:
        began, first, after, upcoming = onward.began, list(onward.first), onward.study, onward.looked
    return _walked(loop, after, [*first, parse(winner.name)[0].name], began.candidates, asked, upcoming)


def _confirms(looked: Looked, study: Study) -> bool:
    """Whether what a round names is a step that the study has already, and physics: a noise model imitates anything."""
    winner = looked.winner
    return winner is not None and not winner.noise and _has(study, winner)


def _has(study: Study, winner: Tried) -> bool:
    return parse(winner.name)[0].name in study.steps[-1].effects


def _may_lead_further(looked: Looked, before: Sequence[Study], study: Study) -> bool:
    """Whether a round's winner is physics that leaves less in the free run than steps that end in a noise model.

    Not where it is the step that came next: what may come after it instead of the others was looked at from there.
    """
    winner = looked.winner
    if not _noisy(study) or winner is None or winner.noise or winner.refit is None:
        return False
    after = {*looked.study.steps[-1].effects, parse(winner.name)[0].name}
    return all(after != set(part.steps[-1].effects) for part in before) \
        and winner.refit.evaluated.rmse < study.steps[-1].error.rmse


def _between(loop: Loop, found: Study, other: Study) -> float:
    """BIC by which one study's last model does better than another's, noise and all, on the same samples."""
    return _last(loop, found).gain_over(_last(loop, other))


def _last(loop: Loop, study: Study) -> Refit:
    """A study's last model, noise and all."""
    piece, _ = described(loop, study.steps[-1].model)
    return quick(*rebuild_model(piece, study.steps[-1].model))


def _ahead(looked: Looked, study: Study) -> float:
    """BIC by which a round's winner does better than the study's last model, noise and all, on the same samples.

    A valve that rests is news, too, whatever won beside it; so is a step that the study has already where in another
    basin it leaves noise as it is, and the study's did not.
    """
    winner = looked.winner
    rests = RESTING in looked.study.steps[-1].effects and RESTING not in study.steps[-1].effects
    other_basin = looked.settled and _noisy(study)
    if not rests and (winner is None or winner.refit is None or (_has(study, winner) and not other_basin)):
        return -np.inf
    return looked.best.gain_over(quick(*rebuild_model(looked.run.loop, study.steps[-1].model)))


def _replaced(chosen: Looked, gone: Sequence[str]) -> Study:
    """The study with its last step put right: a restart found a better optimum of the same model, the process is
    another, or effects that followed it (`gone`) give way to one that does better."""
    study, run, found, instead = chosen.study, chosen.run, chosen.found, chosen.winner
    before = study.steps[-1]
    after = polished(found.fit.model, found.fit.values, run.rng)
    notes = list(chosen.notes)
    if found.better:
        notes.append(Finding(
            "better-optimum", "warning",
            f"a restart found a better optimum of the same model: the error falls from {before.error.rmse:.4g} to "
            f"{after.best.rmse:.4g}, S is {after.best.values['S']:.4g}, J {after.best.values['J']:.4g}; it replaces "
            "the model, so that no effect is named for it",
            {"rmse_before": before.error.rmse, "rmse": after.best.rmse}, (), "CRITICISM.md section 7, step 5"))
    if instead is not None and gone:
        notes.append(Finding(
            "gave-way", "info",
            f"left out again, because {instead.name} explains what it had imitated: {', '.join(gone)}",
            {"effects": list(gone), "instead": instead.name}, (parse(instead.name)[0].name,),
            "CRITICISM.md section 7, step 7"))
    codes = {note.code for note in notes}
    kept = tuple(f for f in before.findings if f.code not in codes)
    step = finished_step(run, after, before.added, (*kept, *notes))
    step = replace(step, variant=before.variant)
    return replace(with_steps(study, run, (*study.steps[:-1], step), after), missing=study.missing)
