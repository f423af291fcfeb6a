"""Ranking and accepting: information criterion and held-out blocks must agree, and physics must beat noise models.

An autoregression can imitate anything one step ahead, so a disturbance or valve effect is named only where it does
clearly better than the best pure noise model. Source: CRITICISM.md section 7, steps 6 and 7.
"""

from __future__ import annotations

import numpy as np

from ..effects import parse
from ..fit.cross_validation import Held
from ..fit.noise.completion import AUTOREGRESSIVE, RANDOM_WALK, Refit, at_noise, has_noise, has_walk
from ..fit.public_values import noise_values, rows_for, values_of
from ..model.spec import INTEGRATOR
from ..process.intersample import kicks
from ..record.study import Candidate
from .detect import detectable
from .steps import SUPERFLUOUS
from .tells import settling
from .tries import NAMED, Round, Tried

# BIC within which two effects are equivalent (CRITICISM.md section 7, step 7).
ALIKE = 10.0
# BIC by which physics must beat a noise model that helps (step 7: "named"): noise in the output of a controller that
# works all the time moves the valve between samples where no model sees it, and 25 were met by chance then.
_OVER_NOISE = 50.0
# Beside a walk, in whose changes of y every slip stands, under a held command: 7 at most were met by chance in 17 loops
# with a walk and nothing else (step 7: "probable").
_OVER_WALK = 20.0
# It need only be better by what names an effect where it takes this share of the free-run error away, which chance does
# not: a walk imitates a slow ramp one step ahead, and was taken for one that was 38 better (step 7: "probable").
HALVED = 0.5
# Blocks in which the one-step error must fall, and the median drop that counts (step 6).
_BLOCKS_BETTER, _MEDIAN_GAIN = 4, 0.005
# The free-run error may not get worse by more than this share.
_NO_WORSE = 1.02
# Two candidates look alike on this record when their outputs differ by less than this share of the innovations.
_LOOK_ALIKE = 0.35
# A number this close to its neutral value, as a share of its range, says that the effect is not there.
_NEUTRAL = 1e-3
# Under a held command a drifting valve also rests at every sample: the drift itself must be worth this share of its
# gain in BIC over re-sticking.
_RESTING, _DRIFT_ALONE = "re-sticking", 0.05
# A step this many samples before a move of the setpoint may still be the valve that met it.
_STEP, _NEAR_KICK = "step-disturbance", 3.0
# Words by how far the best rival of another kind is behind.
_WORDS = ((50.0, "named"), (20.0, "probable"), (10.0, "probable, {rival} not excluded"))


def clearly_better(t: Tried, found: Round) -> bool:
    """BIC, the blocks in sample, and the blocks held out agree that the candidate helps."""
    if t.refit is None or not t.full or t.delta_bic < NAMED or _vanished(t):
        return False
    local = _local(t)
    if not local and ((t.gains > 0).sum() < _BLOCKS_BETTER or float(np.median(t.gains)) < _MEDIAN_GAIN):
        return False
    return holds(t.held, found.held, local)


def _local(t: Tried) -> bool:
    """Whether an effect acts at a place of the record: a disturbance, or a friction that changes with time."""
    effect = parse(t.name)[0]
    return effect.kind == "L" or effect.profile is not None


def _held_worse(t: Tried, noise: Tried) -> bool:
    """Whether a candidate predicts held-out blocks worse than a noise model.

    Nobody can predict a step that lies in the block held out: of a local effect the middle block counts.
    """
    if noise.held is None or t.held is None:
        return False
    if _local(t):
        return bool(np.median(t.held.blocks / noise.held.blocks) > 1.0)
    return t.held.rmse_one_step > noise.held.rmse_one_step


def holds(after: Held | None, before: Held | None, local: bool = False) -> bool:
    """Whether the held-out one-step error falls, in all and in the middle block; true where none could be held out.

    Of a `local` effect either is enough: a drift may leave most blocks as they are, and nobody can predict a step that
    lies in the block held out.
    """
    if after is None or before is None:
        return True
    whole = after.rmse_one_step <= (1.0 - _MEDIAN_GAIN) * before.rmse_one_step
    middle = bool(np.median(1.0 - after.blocks / before.blocks) >= _MEDIAN_GAIN)
    return whole or middle if local else whole and middle


def winner_of(found: Round) -> Tried | None:
    """The candidate to name: physics before noise, but only physics that beats the noise models."""
    noises = [t for t in found.tried if t.noise and clearly_better(t, found)]
    rival = max(noises, key=lambda t: t.delta_bic, default=None)
    # A noise model that helps, though not in every block, must be beaten, too.
    helps = found.noise_gain
    least = max(NAMED, helps + NAMED if helps >= NAMED else 0.0)
    if has_noise(found.fit.model.spec):
        # (Under a held command nothing moves the valve between samples.)
        least = _OVER_WALK if has_walk(found.fit.model.spec) and found.fit.model.spec.held else _OVER_NOISE
    for t in found.tried:
        if t.noise or not clearly_better(t, found) or t.delta_bic < least:
            continue
        if rival is not None and t.delta_bic < rival.delta_bic + (NAMED if halves(t, found) else _OVER_NOISE):
            continue
        if not _against(t, found, rival):
            return t
    # Noise that helps less than a valve that stopped elsewhere only carries what that left.
    kicked = max((t.delta_bic for t in found.tried if not t.noise and clearly_better(t, found) and _may_be_a_kick(t)),
                 default=-np.inf)
    return steadiest(noises) if noises and noises[0].delta_bic > kicked else None


def steadiest(noises: list[Tried]) -> Tried:
    """The best noise model, and of a walk and an autoregression that do alike the latter: it claims less.

    In the changes of y that an integrator is fitted to, both may be the same model.
    """
    best = noises[0]
    if parse(best.name)[0].noise != RANDOM_WALK:
        return best
    return next((t for t in noises if parse(t.name)[0].noise == AUTOREGRESSIVE
                 and best.delta_bic - t.delta_bic < SUPERFLUOUS), best)


def halves(t: Tried, found: Round) -> bool:
    """Whether a candidate takes half of the free-run error away."""
    assert t.refit is not None
    return t.refit.evaluated.rmse <= HALVED * found.reference.evaluated.rmse


def _against(t: Tried, found: Round, noise: Tried | None) -> str:
    """Why a candidate that helps is not named all the same, beside the best noise model; empty where nothing speaks
    against it."""
    assert t.refit is not None
    if not has_walk(found.fit.model.spec) and t.refit.evaluated.rmse > _NO_WORSE * _free_run(t.refit, found):
        return "its free run is worse than that of the model so far"
    if noise is not None and _held_worse(t, noise):
        return f"it predicts held-out blocks worse than {noise.name}"
    if _out_of_range(t):
        return "it ended at a limit of its range"
    if _only_rests(t, found):
        return f"{_RESTING} alone explains nearly as much"
    if _may_be_a_slip(t):
        return "one slip in the wrong place of an integrator looks the same"
    if _may_be_a_kick(t):
        return "the setpoint moved then: where a valve stops under an output that this kicks lies between the samples"
    return ""


def _free_run(refit: Refit, found: Round) -> float:
    """The free-run error of the model without the effect that a refit may not exceed.

    A refit under a noise model does not minimise its free run, so it is held against the model under one, too.
    """
    plain = found.reference.evaluated.rmse
    if not refit.taps.size:
        return plain
    return max([plain, *(t.refit.evaluated.rmse for t in found.tried if t.refit is not None
                         and parse(t.name)[0].noise == AUTOREGRESSIVE)])


def _out_of_range(t: Tried) -> bool:
    """Whether a signal effect or disturbance ended at a limit of its range that is not its neutral value.

    Friction effects may: their far ends are laws of their own, such as a valve that rests at every sample.
    """
    assert t.refit is not None
    model, effect = t.refit.model, parse(t.name)[0]
    if effect.friction is not None or effect.noise is not None:
        return False
    values = {k: v for k, v in model.named(t.refit.values).items() if k.startswith(t.name + ":")}
    for p, value in zip(effect.parameters_for(model.context), values.values(), strict=True):
        near_neutral = abs(p.share(value) - p.share(p.neutral)) <= 0.01
        if p.at_bound(value) and not near_neutral and p.name not in ("lag_s", "dead_time_s"):
            return True
    return False


def _may_be_a_slip(t: Tried) -> bool:
    """Whether a step or ramp of an integrator may be a slip that the model has in the wrong place: that adds up to one.

    It is believed only where the free run with it is at the noise, so that no slip is wrong.
    """
    assert t.refit is not None
    return t.refit.model.spec.process == INTEGRATOR and bool(parse(t.name)[0].variants) and not at_noise(t.refit)


def _may_be_a_kick(t: Tried) -> bool:
    """Whether a step may be a valve that stopped elsewhere where a setpoint move kicked an output that is not held.

    What the output did just before and after lies between samples, and decides where the valve rests for the next half
    cycle: by less than the kick, and y shows it a dead time and a time constant later.
    """
    assert t.refit is not None
    model = t.refit.model
    if model.spec.held or parse(t.name)[0].name != _STEP:
        return False
    numbers = values_of(t.name, model, t.refit.values, t.refit.evaluated)
    size = abs(numbers["size"])
    if parse(t.name)[1] == "output":
        size /= max(abs(t.refit.evaluated.gain), 1e-12)
    named = model.named(t.refit.values)
    after = (numbers["time_s"] - model.loop.clock_s) / model.step_s
    reach = (named["dead_time_s"] + 2.0 * named["time_constant_s"]) / model.step_s
    near = (after > -_NEAR_KICK) & (after < reach + _NEAR_KICK)
    return bool((size < np.abs(kicks(model.loop.output, model.loop.setpoint)))[near].any())


def _only_rests(t: Tried, found: Round) -> bool:
    """Whether a drift of stiction explains hardly more than a valve that rests, which it is under a held command."""
    assert t.refit is not None
    if parse(t.name)[0].profile is None or not t.refit.model.spec.held:
        return False
    rest = max((r.delta_bic for r in found.tried if parse(r.name)[0].name == _RESTING and clearly_better(r, found)),
               default=0.0)
    return rest > (1.0 - _DRIFT_ALONE) * t.delta_bic


def _vanished(t: Tried) -> bool:
    """Whether every searched number of a friction or signal effect ended at the value at which the effect vanishes."""
    assert t.refit is not None
    effect, model = parse(t.name)[0], t.refit.model
    if effect.noise is not None or effect.columns is not None:
        return False
    values = [v for k, v in model.named(t.refit.values).items() if k.startswith(t.name + ":")]
    ranges = effect.parameters_for(model.context)
    return bool(ranges) and all(abs(p.share(v) - p.share(p.neutral)) <= _NEUTRAL
                                for p, v in zip(ranges, values, strict=True))


def equivalents(found: Round, winner: Tried) -> tuple[str, ...]:
    """At most two candidates that do equally well: known pairs, or such as give the same output on this record."""
    names = []
    for t in found.tried:
        if t is winner or t.refit is None or t.delta_bic < NAMED or abs(t.delta_bic - winner.delta_bic) >= ALIKE:
            continue
        # Beside a noise model any effect at its neutral value gives the same output: only known pairs count there.
        if _listed(t.name, winner.name) or (not (t.noise or winner.noise) and _same_output(t, winner)):
            names.append(t.name)
    # Two variants of one effect are one answer.
    plain = [parse(n)[0].name for n in names]
    return tuple(dict.fromkeys(n for n in plain if n != parse(winner.name)[0].name))[:2]


def _listed(a: str, b: str) -> bool:
    first, second = parse(a)[0], parse(b)[0]
    return first.name == second.name or first.name in second.confused_with or second.name in first.confused_with


def _same_output(a: Tried, b: Tried) -> bool:
    assert a.refit is not None and b.refit is not None
    both = (a.refit.evaluated.counted > 0) & (b.refit.evaluated.counted > 0)
    apart = (a.refit.evaluated.model - b.refit.evaluated.model)[both]
    return float(np.sqrt(np.mean(apart**2))) < _LOOK_ALIKE * b.refit.innovation_sd


def candidates(found: Round, winner: Tried | None, p_value: float | None = None) -> tuple[Candidate, ...]:
    """The ranking as it goes into the study, the named effect first."""
    base, step = found.reference.evaluated.rmse, found.reference.innovation_sd
    seen = detectable(found, [t.name for t in found.tried if t is not winner], winner.refit if winner else None)
    same = equivalents(found, winner) if winner is not None else ()
    out = []
    for t in sorted(found.tried, key=lambda t: (t is not winner, -t.delta_bic)):
        size = seen.get(t.name)
        effect, variant = parse(t.name)
        if t.refit is None:
            out.append(Candidate(effect.name, False, None, None, None, None, None, None, (), size, (),
                                 f"{t.name} could not be tried: {t.failed}", variant))
            continue
        rmse, now = t.refit.evaluated.rmse, t.refit.innovation_sd
        out.append(Candidate(
            effect.name, t is winner, rmse, t.held.rmse if t.held else None, t.held.rmse_one_step if t.held else None,
            100.0 * (1.0 - rmse / base) if base else None, 100.0 * (1.0 - now / step) if step else None, t.delta_bic,
            same if t is winner else (), size, rows_for(t.name, _numbers(t)),
            _statement(t, found, winner, same, p_value), variant))
    return tuple(out)


def _numbers(t: Tried) -> dict[str, float]:
    assert t.refit is not None
    r = t.refit
    if t.noise:
        return noise_values(t.name, r.taps, r.increments, r.innovation_sd, r.model.step_s, r.model.pace)
    return values_of(t.name, r.model, r.values, r.evaluated)


def _statement(t: Tried, found: Round, winner: Tried | None, same: tuple[str, ...], p_value: float | None) -> str:
    assert t.refit is not None
    change = (f"one-step error {found.reference.innovation_sd:.4g} to {t.refit.innovation_sd:.4g}, free run "
              f"{found.reference.evaluated.rmse:.4g} to {t.refit.evaluated.rmse:.4g}, BIC {t.delta_bic:+.0f}")
    if t is winner:
        said = f"{t.name} explains it ({_how_sure(t, found, same)}): {change}"
        if p_value is not None:
            said += f", bootstrap p = {p_value:.3g}"
        test = settling(t.name, same or _closest(t, found))
        return said + (f"; what would settle it: {test}" if test else "")
    if winner is not None and parse(t.name)[0].name in same:
        return f"{t.name} does as well as {winner.name} on this record: {change}"
    if _vanished(t):
        return f"{t.name} is not identifiable here, its refit ended where it vanishes: {change}"
    if not t.full:
        return f"{t.name} did not come near enough in a first look to be refitted in full: {change}"
    if t.delta_bic < NAMED:
        return f"{t.name} does not help: {change}"
    if winner is None and p_value is not None and clearly_better(t, found):
        return f"{t.name} is not sure, bootstrap p = {p_value:.3g}: records without it show as much: {change}"
    if winner is None:
        return f"{t.name} is not sure, information criterion and held-out blocks do not agree: {change}"
    why = _against(t, found, winner if winner.noise else None) if t.delta_bic > winner.delta_bic else ""
    if why:
        return f"{t.name} lowers the one-step error more than {winner.name}, but {why}: {change}"
    return f"{t.name} helps less than {winner.name}: {change}"


def _rivals(t: Tried, found: Round) -> list[Tried]:
    kind = parse(t.name)[0].name
    return [o for o in found.tried if o.refit is not None and parse(o.name)[0].name != kind]


def _closest(t: Tried, found: Round) -> tuple[str, ...]:
    near = [o.name for o in _rivals(t, found) if t.delta_bic - o.delta_bic < _WORDS[1][0] and o.delta_bic >= NAMED]
    return tuple(near[:1])


def _how_sure(t: Tried, found: Round, same: tuple[str, ...]) -> str:
    if same:
        return f"or {' or '.join(same)}: these data cannot tell"
    rivals = _rivals(t, found)
    margin = t.delta_bic - max((o.delta_bic for o in rivals), default=-np.inf)
    for limit, word in _WORDS:
        if margin >= limit:
            return word.format(rival=rivals[0].name if rivals else "")
    return f"or {rivals[0].name}: these data cannot tell" if rivals else "named"
