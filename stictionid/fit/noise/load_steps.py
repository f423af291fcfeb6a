"""Times at which the load steps, found one after the other in the innovations of a completed model.

A step of the load leaves in the innovations the response of the process, passed through the model's own noise filter.
Each round adds the time whose response explains most beside those found before. A round must
gain 2 ln n for the time, one of n, and ln n for the size. Wrong where PV is missing and where the dead time drifts: no
time is sought there.
Source: orthogonal least squares, Chen, Billings and Luo 1989; docs/details.md, section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...effects import built_in, parse
from ...effects.contract import MOST_TIMES, name_at, times_in
from ...model.model import Model
from ...model.segments import rebind_model
from ...typing import FloatArray, IntArray
from ..points.moves import descend_values
from .bias_correction import slopes_of
from .completion import Refit, at_noise, complete_quickly
from .load import step_response

# The effect that holds the steps.
STEPS = built_in(lambda effect: effect.ahead)
# Fewest steps that come at random times; one alone is a step disturbance. Share of the energy of a whole response that
# a step must have beside those before, and size below which a column counts as dependent.
_FEWEST, _SEEN, _DEPENDENT = 2, 1e-3, 1e-6
# Most rounds of steps and polish; turns of a descent, and the fall of the cost below which it has settled.
_ROUNDS, _TURNS, _SETTLED = 4, 8, 1e-3


def load_steps_of(done: Refit) -> str:
    """The effect with the load steps of a completed model and those that it lacks; empty where none is new.

    Steps that are known show further ones, so the model is polished with the steps of each round.
    """
    if len(done.model.pieces) > 1 or done.model.links is not None:
        return ""
    have = name = next((n for n in done.model.spec.effects if parse(n)[0].name == STEPS), "")
    for _ in range(_ROUNDS):
        before, name = name, _steps_of(done, name)
        if name == before or not name:
            break
        new = _plain_model(done, before, name)
        start = new.vector(done.model.named(done.values))
        done = complete_quickly(new, descend_values(new, start[:, None], turns=_TURNS, settle=_SETTLED))
    return "" if name == have else name


def _plain_model(done: Refit, without: str = "", *names: str) -> Model:
    """The model of a completed one without its noise model and path, without one effect and with others."""
    model = done.model
    effects = (*(n for n in model.spec.effects if n != without), *names)
    spec = replace(model.spec, effects=effects, taps=done.own, increments=done.increments, paths=None)
    return rebind_model(model, spec)


def _steps_of(done: Refit, have: str) -> str:
    """The effect with the steps that the innovations of a model show beside those that it has.

    A noise model that adds little to a model with steps may stand for one that is missing. Then the free run counts.
    """
    if have and at_noise(done):
        done = complete_quickly(_plain_model(done), done.values, order=0)
    model, polynomial = done.model, done.polynomial
    n, counts = model.loop.samples, done.good.astype(np.float64)
    times, whole = model.context.time_s, done.innovation.copy()
    response = np.convolve(step_response(model, done.values, n), polynomial)[:n]
    known = np.searchsorted(times, times_in(have)).clip(max=n - 1)
    sizes = model.sizes_of(have, done.values, done.evaluated.own) if have else np.empty(0)
    for k, size in zip(known.tolist(), sizes.tolist(), strict=True):
        whole[k:] += size * response[:n - k]
    # The other numbers of the model follow a step, as far as they can.
    plain = _plain_model(done, have)
    slopes = slopes_of(plain, plain.evaluate(done.values))
    beside = [np.convolve(x, polynomial)[:n] * counts for x in slopes.T]
    at = find_steps(whole * counts, response, counts, beside, known)
    return name_at(STEPS, times[at]) if at.size >= _FEWEST else ""


def find_steps(innovation: FloatArray, response: FloatArray, counts: FloatArray, beside: Sequence[FloatArray],
               known: IntArray) -> IntArray:
    """First samples (k,) of the steps in innovations (n,), in order; `response` (n,) is that to a step at the start.

    `counts` (n,) is 1 where a sample counts, else 0. Sizes of the columns (n,) `beside` the steps are free. The `known`
    (m,) steps are tried first. A step that is not needed beside the others is left out.
    """
    n, rows = innovation.size, float(counts.sum())
    if rows < 2 or not innovation.any():
        return known
    size, least = 2 * n, 3.0 * float(np.log(rows))
    spectrum = np.conj(np.fft.rfft(response, size))

    def along(signal: FloatArray) -> FloatArray:
        """Products of a signal (n,) with the response to a step at every sample."""
        return np.asarray(np.fft.irfft(spectrum * np.fft.rfft(signal, size), size)[:n])

    def column_at(k: int) -> FloatArray:
        return np.concatenate([np.zeros(k), response[:n - k]]) * counts

    energy = np.fft.irfft(np.conj(np.fft.rfft(response**2, size)) * np.fft.rfft(counts, size), size)[:n]
    enough = _SEEN * float(energy.max())
    units, at = np.empty((0, n)), known.tolist()

    def without(column: FloatArray) -> FloatArray:
        """The part of a column that those so far leave, of unit length; none of one that depends on them."""
        left = column - (units @ column) @ units
        norm, whole = float(np.linalg.norm(left)), float(np.linalg.norm(column))
        return left[None] / norm if norm > _DEPENDENT * whole else np.empty((0, n))

    for column in beside:
        units = np.concatenate([units, without(column)])
    base = units
    for k in at:
        units = np.concatenate([units, without(column_at(k))])
    energy -= sum((along(unit) ** 2 for unit in units), np.zeros(n))
    left = innovation - (units @ innovation) @ units
    while len(at) < MOST_TIMES:
        best = int(np.where(energy > enough, along(left) ** 2 / np.maximum(energy, enough), 0.0).argmax())
        unit = without(column_at(best))
        now = left - (unit @ left) @ unit
        if rows * float(np.log((left @ left) / max(float(now @ now), 1e-300))) < least:
            break
        energy -= sum((along(one) ** 2 for one in unit), np.zeros(n))
        left, units, at = now, np.concatenate([units, unit]), [*at, best]
    columns = np.array([column_at(k) for k in at]).reshape(len(at), n)
    columns -= (columns @ base.T) @ base
    rest = innovation - (base @ innovation) @ base
    while at:
        # The step whose loss costs least, by its size over its standard error.
        inverse = np.linalg.pinv(columns @ columns.T, rcond=_DEPENDENT, hermitian=True)
        sizes = inverse @ (columns @ rest)
        error = rest - sizes @ columns
        cost = rows * np.log1p(sizes**2 / np.maximum(inverse.diagonal(), 1e-300) / max(float(error @ error), 1e-300))
        if cost.min() >= least:
            break
        weak = int(cost.argmin())
        del at[weak]
        columns = np.delete(columns, weak, axis=0)
    return np.sort(np.array(at, np.int64))
