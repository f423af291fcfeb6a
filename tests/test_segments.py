"""Records with gaps: each segment has a start of its own and none are joined; S, J and process are common.

Identified records of several segments are in benchmarks/long.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import naive
import numpy as np
import pytest

from stictionid.errors import DataError
from stictionid.laws.contract import SINCE
from stictionid.model.closed_loop import preset, simulate
from stictionid.model.model import Model
from stictionid.model.segments import Restarted, bind_model
from stictionid.model.spec import INTEGRATOR, Spec
from stictionid.numerics.varpro import Shared
from stictionid.numerics.varpro_segments import Blockwise, block_columns
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.segments import FEWEST_PERIODS, MOST, chosen, fitted_segments


def with_gaps(loop: Loop, *gaps: tuple[int, int]) -> Loop:
    """The loop without the samples of the gaps, each segment at its time on the clock."""
    keep = np.ones(loop.samples, bool)
    for a, b in gaps:
        keep[a:b] = False
    starts = (0, *(int(keep[:b].sum()) for _, b in gaps))
    begins = (0.0, *(b * loop.step_s for _, b in gaps))
    return Loop(output=loop.output[keep], process_value=loop.process_value[keep],
                setpoint=None if loop.setpoint is None else loop.setpoint[keep],
                position=None if loop.position is None else loop.position[keep],
                extras={tag: x[keep] for tag, x in loop.extras.items()}, step_s=loop.step_s, units=loop.units,
                starts=starts, begins_s=begins)


def scanned(name: str = "foptd", *, S: float = 5.0, J: float = 3.0, seed: int = 0, noise: float = 0.0,
            duration_s: float = 400.0) -> Loop:
    setting = preset(name)
    setting = replace(setting, S=S, J=J, noise_sd=noise, duration_s=duration_s,
                      controller=replace(setting.controller, scan_s=1.0))
    return simulate(setting, seed=seed).loop


@pytest.mark.parametrize("process", ["first-order", INTEGRATOR])
@pytest.mark.parametrize("taps", [(), (-0.6, 0.1)])
def test_a_restarted_model_costs_what_its_twin_does(process: str, taps: tuple[float, ...]) -> None:
    # (without a setpoint nothing tells the sign of the gain, which the twin does not know)
    loop = replace(with_gaps(scanned(noise=0.3), (101, 143), (231, 260)), setpoint=None)
    spec = Spec(process=process, taps=taps)
    model = bind_model(loop, spec, s_max=10.0, period_s=40.0)
    assert isinstance(model, Restarted)
    values = np.array([4.6, 2.1, 0.3, 6.5, 4.3, -0.7, 0.9])
    segments = [(loop.output[p], loop.process_value[p]) for p in loop.segments]
    cost, gain = naive.restarted_cost(segments, 4.6, 2.1, (0.3, -0.7, 0.9), 6.5, 4.3, step=1.0, taps=taps,
                                      skip=[m.skip for m in model.pieces], integrating=process == INTEGRATOR)
    assert model.costs_of(values[:, None])[0] == pytest.approx(cost, rel=1e-4)
    evaluated = model.evaluate(values)
    assert evaluated.sse == pytest.approx(cost, rel=1e-4) and evaluated.gain == pytest.approx(gain, rel=1e-3)
    residual = model.residuals(model.cube(values[:, None]))[:, 0]
    assert float(residual @ residual) == pytest.approx(cost, rel=1e-4)
    np.testing.assert_allclose(residual[model.weight > 0], evaluated.innovation[model.weight > 0], atol=1e-6)


def test_one_segment_is_the_plain_model_and_alone_in_a_restarted_one_the_same() -> None:
    loop = scanned(noise=0.2)
    assert type(bind_model(loop, Spec(), s_max=10.0, period_s=40.0)) is Model
    plain = Model(loop, Spec(), s_max=10.0, period_s=40.0)
    cube = np.random.default_rng(0).random((40, 5))
    whole = Restarted(loop, Spec(), s_max=10.0, period_s=40.0)
    np.testing.assert_allclose(whole.costs(cube), plain.costs(cube), rtol=1e-7)


def test_blockwise_elimination_is_one_wide_least_squares() -> None:
    rng = np.random.default_rng(3)
    sizes, common, local, lanes = (37, 58, 24), 2, 2, 9
    n = sum(sizes)
    weight = rng.random(n) > 0.2
    target = rng.standard_normal(n) + np.repeat([5.0, -3.0, 8.0], sizes)
    base = rng.standard_normal(((common + local) * n, lanes))
    base[2 * n:2 * n + sizes[0], 4] = 0.0  # a transient that is not there gets no coefficient
    edges = np.cumsum([0, *sizes])
    spans = [slice(a, b) for a, b in itertools.pairwise(edges)]
    shared = [np.stack([np.ones(s), np.arange(s)], axis=1) for s in sizes]
    ours = Blockwise(tuple(Shared.prepare(target[p], c, weight[p]) for p, c in zip(spans, shared, strict=True)), common)
    offsets = tuple(i * n for i in range(common + local))
    cost, coefficients = ours.solve(base, offsets)
    residual = ours.residuals(base, offsets)
    for lane in range(lanes):
        columns = [base[i * n:(i + 1) * n, lane] for i in range(common + local)]
        own = columns[:common] + [np.where((np.arange(n) >= p.start) & (np.arange(n) < p.stop), c, 0.0)
                                  for p in spans for c in columns[common:]]
        sse, theta = naive.least_squares(own, block_columns(shared), target, weight.astype(float))
        assert cost[lane] == pytest.approx(sse, rel=1e-9)
        np.testing.assert_allclose(coefficients[:, :common, lane], np.tile(theta[:common], (3, 1)), rtol=1e-7)
        np.testing.assert_allclose(coefficients[:, common:, lane].ravel(), theta[common:], rtol=1e-7, atol=1e-9)
        assert float(residual[:, lane] @ residual[:, lane]) == pytest.approx(sse, rel=1e-9)


def test_glued_segments_are_wrong_where_restarted_ones_are_right() -> None:
    whole = scanned(noise=0.05, duration_s=600.0)
    loop = with_gaps(whole, (151, 173), (297, 340))
    truth = np.array([5.0, 3.0, 0.0, 5.0, 5.0])
    glued = Model(replace(loop, starts=(0,), begins_s=()), Spec(), s_max=10.0, period_s=40.0)
    model = bind_model(loop, Spec(), s_max=10.0, period_s=40.0)
    forces = (whole.output - whole.position)[[0, 173, 340]] / 4.0
    right = model.evaluate(np.concatenate([truth[:2], forces[:1], truth[3:], forces[1:]]))
    assert right.rmse < 0.06
    assert glued.evaluate(truth).rmse > 5.0 * right.rmse


@pytest.mark.parametrize(("name", "given"), [
    ("sinusoidal-disturbance", {"period_s": 61.7}), ("ramp-disturbance", {"start_s": 210.0}),
    ("step-disturbance", {"time_s": 190.0}), ("stiction-drift", {"stickband_growth": 2.0, "jump_growth": 1.0}),
    ("stiction-change", {"stickband_change": -1.0, "jump_change": -0.5, "time_s": 190.0})])
def test_effects_by_the_clock_see_it_with_the_gaps(name: str, given: dict[str, float]) -> None:
    whole = scanned(noise=0.1)
    loop = with_gaps(whole, (101, 143), (231, 260))
    keep = np.r_[0:101, 143:231, 260:whole.samples]
    models = [bind_model(x, Spec(effects=(name,)), s_max=10.0, period_s=40.0) for x in (whole, loop)]
    values = np.concatenate([[4.6, 2.1, 0.3, 6.5, 4.3], list(given.values())])[:, None]
    assert [p.name for p in models[0].space.parameters[5:]] == list(given)
    if name == "stiction-drift":
        np.testing.assert_array_equal(np.concatenate([m.profile for m in models[1].pieces]), models[0].profile[keep])
        return
    if name == "stiction-change":
        own = np.insert(values, 5, [[0.0], [0.0]], axis=0)
        since = [m.friction(models[1].of(i, own))[SINCE, 0] + m.context.start_s for i, m in enumerate(models[1].pieces)]
        assert since == [given["time_s"]] * 3
        return
    full = models[0].own_columns(*models[0].responses(values, filtered=False))
    cut = models[1].own_columns(*models[1].responses(np.insert(values, 5, [[0.0], [0.0]], axis=0), filtered=False))
    count = models[1].shared.common
    assert count > 1
    np.testing.assert_allclose(cut[1:count], full[1:count][:, keep], rtol=1e-9, atol=1e-12)


def test_what_is_chosen_and_what_is_said_of_the_rest() -> None:
    whole = scanned(noise=0.05, duration_s=1500.0)
    period = find_range(whole).period_median_s
    six = with_gaps(whole, *((250 * k - 5, 250 * k) for k in range(1, 5)), (1060, 1100))
    piece, (note,) = chosen(six)
    rows = note.evidence["rows"]
    assert len(rows) == MOST == note.evidence["used"] and note.evidence["segments"] == 6
    assert [first for first, _ in rows] == sorted(first for first, _ in rows) == list(piece.picked)
    assert min(size for _, size in rows) >= FEWEST_PERIODS * period / whole.step_s
    left = sorted(p.stop - p.start for p in six.segments)[:2]
    assert max(left) <= min(size for _, size in rows)
    for first, size in rows:
        np.testing.assert_array_equal(piece.output[piece.starts[piece.picked.index(first)]:][:size],
                                      six.output[first:first + size])
    alone, (said,) = chosen(six, restarts=False)
    assert alone.samples == max(p.stop - p.start for p in six.segments) and said.code == "longest-segment"
    assert "does not restart" in said.statement
    short = with_gaps(whole.cut(0, 500), (350, 390))
    alone, (said,) = chosen(short)
    assert alone.samples == 350 and said.code == "longest-segment" and "shorter than 2 periods" in said.statement
    with pytest.raises(DataError, match="as one segment"):
        fitted_segments(short, {"segments": [[0, 350], [350, 120]]})


def test_cycles_are_whole_inside_one_segment() -> None:
    whole = scanned(noise=0.05, duration_s=900.0)
    loop = with_gaps(whole, (400, 450))
    found, parts = find_range(loop), [find_range(loop.cut(p.start, p.stop)) for p in loop.segments]
    assert found.cycles == parts[0].cycles + tuple(replace(c, start_s=c.start_s + 400.0) for c in parts[1].cycles)
    assert found.reversals == sum(p.reversals for p in parts) and "in 2 segments" in found.reason
    assert found.period_median_s == pytest.approx(find_range(whole).period_median_s, rel=0.02)
    glued = find_range(replace(loop, starts=(0,), begins_s=()))
    assert len(glued.cycles) > len(found.cycles)  # one of them never happened
