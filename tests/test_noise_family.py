"""The noise family against a dense covariance, parameters recovered from simulation, and random walks named in time."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from noise_family import simulated
from scipy.signal import lfilter

from stictionid.numerics.autoregression import autocovariance, autoregression, levinson, predicted_covariance
from stictionid.numerics.noise.exact import Record
from stictionid.numerics.noise.family import AUTOREGRESSION, MEASURED, WALK, WHITE, Noise, resonance_of
from stictionid.numerics.noise.fit import WALK_MARGIN, fit_noise, fits_of
from stictionid.numerics.noise.heavy_tails import likelihood_ratios, log_likelihood
from stictionid.numerics.noise.likelihood import likelihood

NOISES = {
    "white": Noise(),
    "AR(1)": Noise((-0.7,)),
    "AR(2)": Noise((-1.2, 0.8)),
    "AR(8)": Noise((-0.5, 0.2, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05)),
    "AR(1) measured": Noise((), 0.9, 0.4),
    "AR(1) measured, AR(3)": Noise((-0.5, 0.3, 0.1), 0.95, 0.3),
    "slow AR(1) measured": Noise((), 0.99, 0.95),
    "walk": Noise((), 1.0, 0.0),
    "walk measured": Noise((), 1.0, 0.8),
    "walk measured, AR(2)": Noise((-0.5, 0.3), 1.0, 0.6),
    "rho = theta = 1": Noise((-0.4,), 1.0, 1.0),
    "moving average": Noise((), 0.0, 0.5),
}
N = 160


def patterns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(8)
    late = np.ones(N, np.bool_)
    late[:7] = late[60:72] = late[-3:] = False
    return {"all": np.ones(N, np.bool_), "isolated": rng.random(N) > 0.1, "random": rng.random(N) > 0.5,
            "every 5th": np.arange(N) % 5 == 2, "late": late}


@pytest.mark.parametrize("starts", [(0,), (0, 70)])
@pytest.mark.parametrize("pattern", patterns())
@pytest.mark.parametrize("name", NOISES)
def test_likelihood_is_that_of_the_dense_covariance(name: str, pattern: str, starts: tuple[int, ...]) -> None:
    noise, good = NOISES[name], patterns()[pattern]
    v = np.random.default_rng(1).standard_normal(N).cumsum()
    found = likelihood(np.where(good, v, np.nan), noise, good, starts)
    sse, logdet = naive.noise_likelihood(v, good, starts, noise.taps, noise.rho, noise.theta)
    assert found.rows == good.sum() - len(starts)
    assert found.sse == pytest.approx(sse * np.exp(logdet / found.rows), rel=1e-8)
    assert found.deviance == pytest.approx(found.rows * np.log(sse / found.rows) + logdet, abs=1e-6)
    price = noise.numbers * np.log(found.rows)
    assert likelihood(v, noise, good, starts).bic(noise.numbers) == pytest.approx(found.deviance + price)


@pytest.mark.parametrize("pattern", patterns())
@pytest.mark.parametrize("name", [name for name in NOISES if not NOISES[name].walks])
def test_innovations_of_stationary_noise_are_those_of_cholesky(name: str, pattern: str) -> None:
    noise, good = NOISES[name], patterns()[pattern]
    v = np.random.default_rng(2).standard_normal(N)
    innovation, _ = Record(v, good, (0,)).innovations(noise)
    keep = np.flatnonzero(good)
    V = naive.noise_covariance(noise.taps, noise.rho, noise.theta, N)[np.ix_(keep, keep)]
    L = np.linalg.cholesky(V)
    e, g = np.linalg.solve(L, v[keep]), np.linalg.solve(L, np.ones(keep.size))
    log_scale = 2.0 * np.log(np.diag(L)).sum() + np.log(g @ g)
    expected = (e - g * (e @ g) / (g @ g)) * np.exp(0.5 * log_scale / (keep.size - 1))
    np.testing.assert_allclose(innovation[keep], expected, atol=1e-9)
    assert (innovation[~good] == 0.0).all()


@pytest.mark.parametrize("name", NOISES)
def test_the_settled_filter_is_the_recursion(name: str) -> None:
    """Without gaps e = A (1 - rho q^-1) v + theta e(-1) once the start has decayed; 1,000 samples are enough."""
    noise, n = NOISES[name], 1600
    v = np.random.default_rng(4).standard_normal(n)
    polynomial, theta = noise.plain
    plain = np.zeros(n)
    for t in range(n):
        plain[t] = polynomial[:t + 1] @ v[t::-1][:polynomial.size] + theta * (plain[t - 1] if t else 0.0)
    # Scale and level are those of the whole record.
    found = Record(v, np.ones(n, np.bool_), (0,)).innovations(noise)[0][1000:]
    design = np.stack([plain[1000:], np.ones(600)], axis=1)
    sizes, *_ = np.linalg.lstsq(design, found, rcond=None)
    np.testing.assert_allclose(found, design @ sizes, atol=1e-9)
    assert sizes[0] > 0.0


@pytest.mark.parametrize("name", ["walk measured, AR(2)", "AR(2)"])
def test_every_segment_has_a_level_of_its_own(name: str) -> None:
    noise, good = NOISES[name], np.ones(N, np.bool_)
    good[:4] = False
    v = np.random.default_rng(6).standard_normal(N)
    moved = v + np.where(np.arange(N) < 70, 5.0, -3.0)
    one, other = (Record(x, good, (0, 70)) for x in (v, moved))
    assert one.rows == N - 6
    np.testing.assert_allclose(other.innovations(noise)[0], one.innovations(noise)[0], atol=1e-12)
    if noise.walks:
        # The first sample of a segment sets the level.
        assert (one.innovations(noise)[0][[0, 1, 2, 3, 4, 70]] == 0.0).all()


def test_rho_of_one_is_the_limit_of_slow_noise() -> None:
    v, good = np.random.default_rng(7).standard_normal(N).cumsum(), patterns()["isolated"]
    walk, slow = (likelihood(v, Noise((-0.4,), rho, 0.6), good) for rho in (1.0, 1.0 - 1e-7))
    assert slow.rows == walk.rows
    assert slow.deviance == pytest.approx(walk.deviance, abs=1e-3)
    level, white = likelihood(v, Noise((), 1.0, 1.0), good), likelihood(v, Noise(), good)
    assert level == white


def test_names_and_numbers() -> None:
    kinds = {name: (noise.kind, noise.numbers) for name, noise in NOISES.items()}
    assert kinds["white"] == (WHITE, 0)
    assert kinds["AR(8)"] == (AUTOREGRESSION, 8)
    assert kinds["AR(1) measured, AR(3)"] == (MEASURED, 5)
    assert kinds["walk"] == (WALK, 0)
    assert kinds["walk measured, AR(2)"] == (WALK, 3)
    assert kinds["rho = theta = 1"] == (AUTOREGRESSION, 1)
    assert NOISES["walk"].walks and not NOISES["rho = theta = 1"].walks
    with pytest.raises(ValueError, match="outside 0 to 1"):
        Noise((), 1.2)
    with pytest.raises(ValueError, match="not finite"):
        Noise((float("nan"),))
    assert likelihood(np.arange(9.0), Noise((-1.01,)), np.ones(9, np.bool_)).deviance == np.inf


def test_a_resonance_is_read_from_the_poles() -> None:
    radius, angle = np.exp(-2.0 * np.pi / 20.0 / (2.0 * np.pi * 4.0)), 2.0 * np.pi / 20.0
    taps = np.convolve([1.0, -2.0 * radius * np.cos(angle), radius**2], [1.0, -0.5])[1:]
    found = resonance_of(Noise(tuple(taps)), 3.0)
    assert found is not None
    assert found == (pytest.approx(60.0), pytest.approx(4.0))
    assert resonance_of(Noise((-0.99,)), 1.0) is None
    assert resonance_of(Noise((-0.5, 0.3)), 1.0) is None
    assert resonance_of(Noise(), 1.0) is None


# Tolerances: about four standard errors at 2,000 samples, of which the second half of the seeds miss a fifth.
@pytest.mark.parametrize("seed", range(4))
def test_parameters_are_recovered(seed: int) -> None:
    rng = np.random.default_rng([seed, 31_000])
    n = 2000
    good = np.ones(n, np.bool_) if seed < 2 else rng.random(n) > 0.2
    plain = fit_noise(simulated(Noise((-1.6, 0.9)), n, rng), good)
    assert plain.kind == AUTOREGRESSION and len(plain.taps) == 2
    assert plain.taps == pytest.approx((-1.6, 0.9), abs=0.05)
    measured = fit_noise(simulated(Noise((), 0.95, 0.6), n, rng), good)
    assert measured.kind == MEASURED and not measured.taps
    assert measured.rho == pytest.approx(0.95, abs=0.04) and measured.theta == pytest.approx(0.6, abs=0.12)
    walk = fits_of(simulated(Noise((-0.6,), 1.0, 0.85), n, rng), good)[WALK].noise
    assert len(walk.taps) == 1
    assert walk.taps == pytest.approx((-0.6,), abs=0.12) and walk.theta == pytest.approx(0.85, abs=0.08)
    assert fit_noise(rng.standard_normal(n), good).white


@pytest.mark.parametrize("kept", [np.arange(6000) % 5 == 3, np.arange(6000) % 5 != 3], ids=["kept", "missing"])
@pytest.mark.parametrize("seed", range(2))
def test_every_5th_sample_costs_rows_and_nothing_else(kept: np.ndarray, seed: int) -> None:
    """AR(1) under measurement noise, seen in a fifth or in four fifths of 6,000 samples."""
    rng = np.random.default_rng([seed, 32_000])
    truth = Noise((), 0.97, 0.8)
    v = simulated(truth, kept.size, rng)
    assert likelihood(v, truth, kept).rows == kept.sum() - 1
    found = fits_of(v, kept)[MEASURED].noise
    assert found.rho == pytest.approx(truth.rho, abs=0.03) and found.theta == pytest.approx(truth.theta, abs=0.1)
    # The samples that are there, taken for neighbours, have another noise: its fit is not better than this one.
    walk = simulated(Noise((), 1.0, 0.9), kept.size, rng)
    assert fit_noise(walk, kept).kind == WALK


def test_the_fit_is_the_maximum_of_the_likelihood() -> None:
    """No neighbour of a fit is better than by rounding of the stopping rule (0.02 in -2 log L)."""
    rng = np.random.default_rng(33_000)
    good = rng.random(1500) > 0.3
    v = simulated(Noise((-0.5,), 0.98, 0.7), 1500, rng)
    for fitted in fits_of(v, good).values():
        best = likelihood(v, fitted.noise, good).deviance
        assert best == pytest.approx(fitted.deviance, abs=1e-6)
        taps, rho, theta = fitted.noise.taps, fitted.noise.rho, fitted.noise.theta
        for i in range(len(taps)):
            for step in (-0.02, 0.02):
                moved = tuple(tap + step * (j == i) for j, tap in enumerate(taps))
                assert likelihood(v, Noise(moved, rho, theta), good).deviance > best - 0.02
        for step in (-0.01, 0.01):
            if theta and 0.0 <= theta + step <= rho:
                assert likelihood(v, Noise(taps, rho, theta + step), good).deviance > best - 0.02


def test_a_walk_must_gain_the_margin() -> None:
    rng = np.random.default_rng(34_000)
    v, good = simulated(Noise((), 1.0, 0.8), 1500, rng), np.ones(1500, np.bool_)
    found = fits_of(v, good)
    gain = min(f.bic for kind, f in found.items() if kind != WALK) - found[WALK].bic
    assert gain > WALK_MARGIN
    assert fit_noise(v, good, walk_margin=gain - 0.1).kind == WALK
    assert fit_noise(v, good, walk_margin=gain + 0.1).kind != WALK


def test_walks_are_named_and_slow_noise_is_not() -> None:
    """Benchmark in small: 12 records of 1,500 samples; nine in ten walks are named, one in a hundred others."""
    good = np.ones(1500, np.bool_)
    walks = [fit_noise(simulated(Noise((), 1.0, 0.9), 1500, np.random.default_rng([seed, 38_000])), good)
             for seed in range(12)]
    assert sum(noise.kind == WALK for noise in walks) >= 9
    others = [fit_noise(simulated(Noise((-0.9,)), 1500, np.random.default_rng([seed, 39_000])), good)
              for seed in range(12)]
    assert sum(noise.kind == WALK for noise in others) <= 1


def test_two_segments_with_two_levels_are_one_noise() -> None:
    rng = np.random.default_rng(35_000)
    noise = Noise((-0.8,))
    v = np.concatenate([simulated(noise, 900, rng) + 40.0, simulated(noise, 900, rng) - 25.0])
    good = np.ones(1800, np.bool_)
    found = fit_noise(v, good, (0, 900))
    assert found.kind == AUTOREGRESSION and found.taps == pytest.approx((-0.8,), abs=0.06)


def test_short_and_empty_residuals_are_white() -> None:
    rng = np.random.default_rng(36_000)
    assert fit_noise(rng.standard_normal(15).cumsum(), np.ones(15, np.bool_)) == Noise()
    assert fit_noise(np.zeros(200), np.ones(200, np.bool_)) == Noise()
    assert fit_noise(np.full(200, np.nan), np.zeros(200, np.bool_)) == Noise()
    assert len(fit_noise(rng.standard_normal(60).cumsum(), np.ones(60, np.bool_)).taps) <= 5


def test_units_do_not_matter() -> None:
    rng = np.random.default_rng(37_000)
    v, good = simulated(Noise((-0.5,), 1.0, 0.8), 1000, rng), rng.random(1000) > 0.1
    one, other = fits_of(v, good), fits_of(1e6 * v + 1e6, good)
    assert one.keys() == other.keys()
    for kind in one:
        assert other[kind].bic - one[kind].bic == pytest.approx((good.sum() - 1) * np.log(1e12), abs=0.05)
        assert other[kind].noise.theta == pytest.approx(one[kind].noise.theta, abs=1e-2)


def test_the_autoregression_predicts_forwards_and_backwards() -> None:
    rng, n = np.random.default_rng(2), 90
    x = rng.standard_normal(n)
    for k in range(2, n):
        x[k] += 1.7 * x[k - 1] - 0.8 * x[k - 2]
    good = np.ones(n, bool)
    good[:3] = good[40:52] = False
    for starts, chains in (((0,), (x[3:40], x[52:])), ((0, 30), (x[3:30], x[30:40], x[52:]))):
        covariance, taps, variance = naive.burg(chains, 5)
        found = predicted_covariance(x, good, 5, starts)
        np.testing.assert_allclose(found, covariance, rtol=1e-9)
        *_, (last, left) = levinson(found)
        np.testing.assert_allclose(last, taps, rtol=1e-7)
        assert left == pytest.approx(variance)


def test_a_smooth_disturbance_keeps_its_innovations() -> None:
    # Roots of 0.98 and 0.9, 600 samples: products of samples alone leave innovations a tenth too large.
    rng, n, taps = np.random.default_rng(4), 600, np.poly([0.98, 0.9])
    ratios = []
    for _ in range(40):
        x = lfilter([1.0], taps, rng.standard_normal(n + 400))[400:]
        own = [np.std(lfilter(np.concatenate([[1.0], a]), [1.0], x)[8:]) for a in (
            autoregression(x, np.ones(n, bool), 2), list(levinson(autocovariance(x, np.ones(n, bool), 2)))[-1][0])]
        ratios.append([r / np.std(lfilter(taps, [1.0], x)[8:]) for r in own])
    own, plain = np.mean(ratios, axis=0)
    assert abs(own - 1.0) < 0.01 < plain - 1.0


@pytest.mark.parametrize("freedom", [2.5, 4.0, 20.0])
def test_the_student_likelihood_is_that_of_its_density(freedom: float) -> None:
    e = 0.03 * np.random.default_rng(3).standard_t(freedom, 40)
    assert log_likelihood(e, freedom) == pytest.approx(naive.student_log_likelihood(e.tolist(), freedom), abs=1e-6)


def test_a_jump_that_one_model_meets_by_chance_is_no_evidence() -> None:
    rng = np.random.default_rng(5)
    plainer = rng.standard_t(3.0, 1000)
    fuller = plainer.copy()
    fuller[np.argsort(np.abs(plainer))[-3:]] *= 0.2
    normal = 1000 * float(np.log((plainer @ plainer) / (fuller @ fuller)))
    assert normal > 100.0 and likelihood_ratios(fuller, plainer).sum() < 0.3 * normal
    # Normal innovations have the normal ratio, and errors at slips that only one model has are no tails.
    noise = rng.standard_normal(1000)
    slips = noise.copy()
    slips[::40] += 4.0
    ratio = 1000 * float(np.log((slips @ slips) / (noise @ noise)))
    assert likelihood_ratios(noise, slips).sum() == pytest.approx(ratio, rel=0.2)
    assert likelihood_ratios(noise, 1.1 * noise).sum() == pytest.approx(2000 * np.log(1.1), rel=1e-6)
