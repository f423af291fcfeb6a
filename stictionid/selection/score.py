"""Score of a node: the model completed with the noise family, and the BIC of its innovations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..effects import built_in, parse
from ..effects.contract import DIAGNOSE
from ..fit.adequacy import MOST_MOVED
from ..fit.cross_validation import Held, held_out
from ..fit.intervals.along_path import share_moved
from ..fit.noise.bias_correction import slopes_of
from ..fit.noise.completion import (
    AUTOREGRESSIVE,
    RANDOM_WALK,
    RESONANT,
    Refit,
    better_refit,
    complete_model,
    complete_quickly,
    complete_with_band,
    explains_slips,
    place_slips,
    residual_band,
)
from ..fit.noise.load import LOAD, residual_load
from ..fit.noise.whiteness import has_long_memory, passes_tests
from ..fit.points.fitted import Fitted, as_it_stands
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import FIRST_ORDER, SOFT, Spec
from ..numerics.noise.exact import Fitted as FittedNoise
from ..numerics.noise.exact import Record
from ..numerics.noise.family import WALK, Noise, resonance_of
from ..numerics.noise.fit import fit_noise, fits_of
from ..numerics.noise.likelihood import likelihood
from ..numerics.noise.load import LoadNoise
from ..system import evaluations
from ..typing import FloatArray
from .node import node
from .policy import Policy


def _noise_called(kind: str) -> str:
    return built_in(lambda effect: effect.noise == kind and effect.asked == DIAGNOSE)


WALKING, COLOURED, NARROW, OF_LOAD = map(_noise_called, (RANDOM_WALK, AUTOREGRESSIVE, RESONANT, LOAD))


@dataclass(frozen=True)
class Scored:
    """A node's best point: the model completed with its noise, and whether it was fitted in full."""

    done: Refit
    full: bool = True
    # Least free-run error that its look met, in the unit of y.
    rmse_of_look: float = np.inf

    @cached_property
    def held(self) -> Held | None:
        """Held-out errors; None for a look, and for a record too short for the folds."""
        return held_out(self.done) if self.full else None

    @cached_property
    def held_by_law(self) -> Held | None:
        """Held-out errors of a valve that slips where its law says: PV of the block held out places no slip."""
        done = self.done
        if done.model.spec.paths is None or not self.full:
            return self.held
        return held_out(complete_quickly(done.model.along(None), done.values))

    @property
    def rmse(self) -> float:
        """Free-run error in the unit of y."""
        return self.done.evaluated.rmse

    @cached_property
    def rmse_by_law(self) -> float:
        """Free-run error in the unit of y of a valve that slips where its law says: PV places no slip."""
        done = self.done
        return self.rmse if done.model.spec.paths is None else done.model.along(None).evaluate(done.values).rmse

    @property
    def least_rmse(self) -> float:
        """Free-run error in the unit of y, at the point of a look where it is least."""
        return min(self.rmse, self.rmse_of_look)

    def error_over(self, *others: Scored) -> float:
        """Least error over the least of others, with valves that all slip by their law.

        Where PV placed the slips, the ratio of the errors with these slips counts if it is the lesser one. It alone
        would say little: slips that PV moved also take up what a missing effect leaves.
        """
        placed, tiny = self.done.model.spec.paths is not None, float(np.finfo(float).tiny)
        # (a record without noise may leave nothing)
        by_law = (self.rmse_by_law if placed else self.least_rmse) / max(min(s.rmse_by_law for s in others), tiny)
        return min(by_law, self.least_rmse / max(min(s.rmse for s in others), tiny)) if placed else by_law

    @property
    def jumps_past(self) -> bool:
        """True for a slip jump larger than the stickband: a valve that slides then needs a friction below zero."""
        values = self.done.evaluated.values
        return values["J"] > values["S"]

    @cached_property
    def by_pv(self) -> bool:
        """True where PV moved so many slips of the path that a missing effect may be the reason."""
        return (share_moved(self.done.model, self.done.values) or 0.0) > MOST_MOVED

    @cached_property
    def without_friction(self) -> float:
        """Free-run error of the same model with a valve that follows its command, in the unit of y."""
        model, values = self._following
        return model.evaluate(values).rmse

    @cached_property
    def gain_by_friction(self) -> float:
        """BIC by which the valve does better than one that follows its command, with noise of the same kind."""
        return self.done.gain_over(complete_quickly(*self._following))

    @property
    def _following(self) -> tuple[Model, FloatArray]:
        """The same model with a valve that follows its command, which takes no path, and its values (d,)."""
        model = self.done.model.along(None)
        return model, model.vector({**model.named(self.done.values), "S": 0.0, "J": 0.0})

    @cached_property
    def band(self) -> Refit | None:
        """The model with narrow-band noise, not refitted; None where the band's phase wanders within one cycle."""
        return complete_with_band(self.done)

    @cached_property
    def white(self) -> bool:
        """True where the innovations pass every test for whiteness."""
        return self.done.white

    @cached_property
    def noise_alone(self) -> bool:
        """True where the innovations are white, and the noise model's memory is too short for a disturbance."""
        return self.done.noise_alone

    def like_noise(self, policy: Policy) -> bool:
        """True where noise of short memory is left, beside a random walk or without one.

        An autoregression of long memory also whitens what a wrong valve or a missing effect leaves. So do differences
        of an integrator: it adds up the slips of a wrong valve as it adds up noise of the load.
        """
        walks = self.done.increments and (self.done.model.spec.process == FIRST_ORDER or self.leaves_little(policy))
        return self.noise_alone or (self.white and walks and not has_long_memory(self.done.taps))

    def needs_no_noise_model(self, policy: Policy) -> bool:
        """True where the free-run error is hardly larger than the innovations."""
        return self.rmse <= policy.carried * self.done.noise_error

    @cached_property
    def unresolved(self) -> bool:
        """True where the free-run error is less than any transmitter resolves."""
        return self.rmse <= self.done.model.loop.resolution

    def is_explained(self, policy: Policy) -> bool:
        """True where the innovations are white and the free-run error is hardly larger, or none is resolved."""
        return self.unresolved or (self.white and self.needs_no_noise_model(policy))

    def only_noise(self, policy: Policy) -> bool:
        """True where the model leaves only noise of short memory, or is explained."""
        return self.noise_alone or self.is_explained(policy)

    def leaves_little(self, policy: Policy) -> bool:
        """True where the free-run error is at most `nearly` times the noise."""
        return self.rmse <= policy.nearly * self.done.noise_error

    def acts_as_integrator(self, policy: Policy) -> bool:
        """True for a first-order process whose lag is many periods long, so that it acts as an integrator."""
        done = self.done
        return done.model.spec.process == FIRST_ORDER and \
            done.evaluated.values["time_constant_s"] >= policy.endless_lag * done.model.period_s

    @property
    def residual(self) -> FloatArray:
        """Free-run residual (n,) less what errors of landing made; 0 where y is missing."""
        return self.done.model.take_out_landings(np.nan_to_num(self.done.evaluated.residual))

    @cached_property
    def at_output(self) -> dict[str, FittedNoise]:
        """The best noise of each kind under the free run, white noise included, that enters at the output."""
        done = self.done
        return fits_of(self.residual, done.evaluated.counted > 0, done.model.loop.starts)

    @cached_property
    def ahead(self) -> tuple[LoadNoise, float] | None:
        """The best noise ahead of the process under the free run, and its BIC; None where there can be none."""
        done, found = self.done, []
        for walks in (False, True):
            if (load := residual_load(done.model, done.evaluated, walks)) is not None:
                found.append((load, self.bic_under(Noise(tuple(load.taps.tolist()), float(walks)), load.numbers)))
        return min(found, key=lambda each: each[1], default=None)

    @cached_property
    def banded(self) -> float:
        """BIC of narrow-band noise under the free run, at its values, as those of `at_output`; inf without a band."""
        band = residual_band(self.done)
        return np.inf if band is None else self.bic_under(Noise(tuple(band[0].tolist())), band[1])

    def bic_under(self, noise: Noise, numbers: int) -> float:
        """BIC of the free run under a noise model with so many fitted numbers, at its values."""
        done = self.done
        return likelihood(self.residual, noise, done.evaluated.counted > 0, done.model.loop.starts).bic(numbers)

    def is_white_under(self, noise: Noise) -> bool:
        """True where the innovations of the free run under a noise model pass every test for whiteness.

        What the smooth numbers of the model explain of them is taken out: a fit under this noise would.
        """
        done = self.done
        good, starts = done.evaluated.counted > 0, done.model.loop.starts
        columns = [self.residual, *slopes_of(done.model, done.evaluated).T]
        innovation, *slopes = (Record(x, good, starts).innovations(noise)[0] for x in columns)
        white, beside = np.zeros(good.size), np.stack(slopes, axis=1)[good]
        white[good] = innovation[good] - beside @ np.linalg.lstsq(beside, innovation[good], rcond=None)[0]
        return passes_tests(done.model, noise.plain[0], noise.numbers, done.evaluated.position, white, good)

    @property
    def free_run_at_noise(self) -> bool:
        """True where the residual needs no noise model at all."""
        return not self.done.taps.size and not self.done.increments


def complete_as_is(model: Model, values: FloatArray) -> Refit:
    """The model completed with the best of an autoregression, a random walk and load noise, not refitted to it."""
    return place_slips(complete_by_law(model, values), rounds=0)


def complete_by_law(model: Model, values: FloatArray) -> Refit:
    """The same with a valve that slips where its law says."""
    found = _complete_quickly(model, values)
    walk = _as_walk(model, found)
    return found if walk is None else better_refit(found, _complete_quickly(*walk))


def complete_look(model: Model, values: FloatArray, fit: Fitted, policy: Policy) -> Refit:
    """`complete_as_is` for a look at a child of a fit; no path is sought for a look far behind by its law.

    A fit along a path lends its slips, so that its looks may come from far behind.
    """
    done, before = complete_by_law(model, values), complete_fit(fit)
    far = before.model.spec.paths is None and done.gain_over(before) < -policy.within
    return done if far else place_slips(done, rounds=0)


def complete_fit(fit: Fitted) -> Refit:
    """`complete_as_is` of a fit, made once: all children are compared with it.

    It counts nothing: which process makes it is no property of the search.
    """
    known = fit.completed.get("as it is")
    if known is None or known[0] is not fit.model or known[1] is not fit.values:
        before = evaluations.samples_spent()
        known = fit.completed["as it is"] = fit.model, fit.values, complete_as_is(fit.model, fit.values)
        evaluations.take_back(before)
    done: Refit = known[2]
    return done


def _complete_quickly(model: Model, values: FloatArray) -> Refit:
    """The model completed with an autoregression or load noise; a white residual needs neither."""
    found = complete_quickly(model, values)
    return better_refit(found, complete_quickly(model, values, noise=LOAD)) if found.taps.size else found


def _prefer_load(model: Model, found: Refit, rng: np.random.Generator) -> Refit:
    """The better of a completed model and the same refitted under load noise, where that is better at its values."""
    if not found.taps.size:
        return found
    values = model.vector(found.model.named(found.values))
    if not complete_quickly(model, values, noise=LOAD).gain_over(found) > 0.0:
        return found
    return better_refit(found, complete_model(model, values, None, rng, noise=LOAD, descent=True))


def complete_with_noise(model: Model, values: FloatArray, rng: np.random.Generator, policy: Policy,
                        pool: Callable[[], FloatArray] | None = None) -> Refit:
    """The model refitted with the best noise of the family: an autoregression in levels, or in softened differences.

    The exact likelihood of the residual decides: criteria of levels and of differences differ by a row. `pool` gives
    starts (k, 5) of the base for the differences, beside the values; it is a search, so it is asked only for them.
    """
    found = place_slips(complete_model(model, values, None, rng, descent=True), values)
    found = _prefer_load(model, found, rng)
    walk = _as_walk(found.model, found)
    if walk is None or not has_long_memory(found.taps):
        return found
    # Noise of long memory may have moved the valve into another basin, so differences are fitted as well.
    softened = place_slips(complete_model(*walk, pool and pool(), rng, descent=True), found.values)
    softened = _prefer_load(walk[0], softened, rng)
    gain = softened.gain_over(found)
    return softened if gain > policy.alike or (gain > -policy.alike and _noise(softened).walks) else found


def _as_walk(model: Model, found: Refit) -> tuple[Model, FloatArray] | None:
    """A first-order model in softened differences; None where it is one already, or integrates."""
    spec = model.spec
    if spec.process != FIRST_ORDER or spec.increments:
        return None
    soft = rebind_model(model, replace(spec, increments=True, taps=SOFT), found.evaluated.left)
    return soft, found.values


def _noise(done: Refit) -> Noise:
    """The noise of the family under a free-run residual."""
    e = done.evaluated
    return fit_noise(np.nan_to_num(e.residual), e.counted > 0, done.model.loop.starts)


def beyond_noise(done: Refit) -> float:
    """BIC of a completed model over y without one, completed with noise of the same family.

    -inf for a record too short for the noise family: nothing shows there that a model does better.
    """
    y, good = done.model.loop.process_value, done.good
    alone = fits_of(np.nan_to_num(y - np.mean(y[good])), good, done.model.loop.starts)
    return min((f.bic for f in alone.values()), default=-np.inf) - done.bic(good)


def _averages_dominate(done: Refit) -> bool:
    """True where averages over two periods, or two lags, hold more than half of the squared free-run error.

    The error of a single wrong slip is shorter: it ends with the next slip and decays with the lag.
    """
    e, longest = done.evaluated, max(done.model.period_s, done.evaluated.values["time_constant_s"])
    width = max(round(2 * longest / done.model.step_s), 1)
    counted = e.counted > 0
    count, total = (np.add.reduceat(x, np.arange(0, counted.size, width)) for x in
                    (counted.astype(np.float64), np.where(counted, e.residual, 0.0)))
    mean = total.sum() / max(count.sum(), 1.0)
    averages = float(np.sum((total - count * mean)[count > 0.0] ** 2 / count[count > 0.0]))
    return averages > float(np.sum((e.residual[counted] - mean) ** 2)) / 2


def noise_name(scored: Scored, policy: Policy, *, slow: bool = False) -> str:
    """The name of the noise under the free run; empty for white noise, or for less than the margin.

    An integrator adds up the errors of its slips, which looks like noise of long memory. Such noise is named there only
    for a fast random walk: 1 - theta is half or more, and its own innovations are white. In benchmarks/plants true
    walks had a theta of 0.43, slips of clean loops 0.79 to 1. A first-order process with a lag of many periods counts
    as an integrator.

    A resonance that lasts more than one cycle is a narrow band, and so is one that gains the margin over any other
    noise, ahead of the process or at the output. An autoregression can't whiten a band under white noise. So
    innovations that are not white allow the name of a band only, or of a random walk whose own innovations are white.
    The band must gain the margin over the autoregression, and either the autoregression resonates or the band's
    innovations are white.

    Noise ahead of the process is named where it explains the free run by `alike` BIC better than any noise at the
    output. Slips in the wrong place are pulses of the load. So it is not named in a record slower than the scan, nor
    for an integrator where white noise makes most of the innovations.

    Of a swinging door's values every other one is kept for its error, so their errors alternate: that names no noise.

    `slow` is True for a record slower than the controller's scan. Its slips are placed early or late, which looks like
    noise of short memory. There a random walk must outlast several slips, and a band that only an autoregression shows
    two cycles. Slips in the wrong place make no band that gains the margin over other noise.
    """
    done, found = scored.done, scored.at_output
    if scored.unresolved:
        return ""
    still = min((f for kind, f in found.items() if kind != WALK), key=lambda f: f.bic, default=None)
    if still is None:
        return ""
    levels = done.model.spec.process == FIRST_ORDER and not scored.acts_as_integrator(policy)
    walk = found.get(WALK, still)
    walks = walk.bic < still.bic - policy.walk_margin if levels else (
        2 * walk.noise.theta <= 1.0 and walk.bic < still.bic and _averages_dominate(done)
        and (scored.noise_alone or not slow))
    best = walk if walks else still
    if scored.bic_under(Noise(), 0) - best.bic < policy.noise_margin:
        return ""
    white = scored.white or (best.noise.walks and scored.is_white_under(best.noise))
    if scored.white:
        ahead = scored.ahead if not slow and (
            levels or (scored.ahead is not None and scored.ahead[0].ratio <= 1.0)) else None
        at_output, of_load = min(f.bic for f in found.values()), np.inf if ahead is None else ahead[1]
        if min(at_output, of_load) - scored.banded >= policy.noise_margin:
            return NARROW
        if at_output - of_load >= policy.alike:
            return OF_LOAD
    resonance = resonance_of(still.noise, done.model.step_s)
    narrow = resonance is not None
    if not white:
        band = scored.band
        named = band is not None and (narrow or band.white) and band.gain_over(done) >= policy.noise_margin
        return NARROW if named else ""
    if slow and (best.noise.walks or not scored.noise_alone):
        lasting = _averages_dominate(done) if best.noise.walks else resonance is not None and resonance[1] > 2
        if not lasting:
            return ""
    if best.noise.walks:
        return WALKING
    nameless = (has_long_memory(best.noise.plain[0][1:]) and not levels) or done.model.loop.drawn
    return NARROW if narrow else "" if nameless else COLOURED


def noise_rival(scored: Scored, policy: Policy, name: str) -> str:
    """The name of noise ahead of the process where it can't be told from the noise at the output that is named."""
    if name not in (COLOURED, WALKING) or scored.ahead is None:
        return ""
    return OF_LOAD if min(f.bic for f in scored.at_output.values()) - scored.ahead[1] > -policy.alike else ""


def noise_words(done: Refit) -> str:
    """The noise that completes a node, as the tree shows it."""
    order = f"order {done.taps.size}" if done.taps.size else "white"
    return f"differences, {order}" if done.increments else order


def is_noise(name: str) -> bool:
    """True for the name of a noise model."""
    return parse(name)[0].noise is not None


def point_in_search_form(scored: Scored, spec: Spec) -> Fitted:
    """The node's point in its search form, ready for looks at its children."""
    done = scored.done
    # Slips that PV placed are kept where little is left to explain. Elsewhere they would fit the missing effect.
    paths = done.model.spec.paths if explains_slips(done) else None
    model = rebind_model(done.model, replace(node(spec, soft=done.increments), paths=paths), done.evaluated.left)
    return as_it_stands(model, model.vector(done.model.named(done.values)))
