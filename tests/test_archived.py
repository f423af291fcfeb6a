"""Signals that a historian thinned: found by their texture, taken for nothing else, and an OP that comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import lossy
import numpy as np
import pytest
from real_nodes import SAMPLES, recorded, scored
from rounding import in_steps, setting_of
from scipy.signal import lfilter

from stictionid.effects import get
from stictionid.fit.adequacy import noise_floor, said_rounding
from stictionid.fit.context import Run
from stictionid.fit.friction_free import gain_of_friction, with_and_without
from stictionid.fit.intervals.assemble import command_margin
from stictionid.fit.noise.prewhitening import whiten_model
from stictionid.fit.starts.intersample import surely_moves
from stictionid.historian import read, read_loop
from stictionid.model.closed_loop import Controller, Plant, Setting, preset, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.numerics.archived import EXCEPTION, LINES, archived
from stictionid.numerics.autoregression import irreducible_error
from stictionid.process.controller_law import controller_law
from stictionid.process.rounded import drawn_lines, measured_rows, thinned_output, unknown_step
from stictionid.record.controller import REBUILT
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.selection.policy import Policy
from stictionid.selection.score import COLOURED, noise_name
from stictionid.typing import FloatArray
from stictionid.verbs.identify import Options, identify

SETTING = setting_of(4)[0]
WAYS = {"exception": EXCEPTION, "door": LINES}


@pytest.fixture(scope="module")
def loop() -> Loop:
    return simulate(replace(SETTING, duration_s=1500.0), seed=4).loop


def kept_of(signal: FloatArray, way: str, deadband: float) -> np.ndarray:
    return (lossy.kept_by_exception if way == "exception" else lossy.kept_by_door)(signal, deadband)


@pytest.mark.parametrize("times", [2.0, 4.0])
@pytest.mark.parametrize("way", WAYS)
def test_the_way_and_the_kept_values_come_back(loop: Loop, way: str, times: float) -> None:
    deadband = times * SETTING.noise_sd
    thin = np.round(lossy.lossy(loop.process_value, way, deadband), 4)
    found = archived(thin, (0,), loop.output)
    assert found is not None and found.way == WAYS[way]
    # Exceptions tell their deadband, straight lines only its size.
    assert abs(np.log(found.deadband / deadband)) < (0.05 if way == "exception" else np.log(3.0))
    kept, said = kept_of(loop.process_value, way, deadband), np.flatnonzero(found.kept)
    assert np.isin(said, [*kept, 0]).mean() > 0.98 and np.isin(kept, said).mean() > 0.95
    held = np.delete(np.arange(loop.samples), said)
    assert (np.abs(thin - np.round(loop.process_value, 4))[said] <= 1e-9).mean() > 0.98 and held.size > 300


def test_signals_that_nobody_thinned_are_left_alone(loop: Loop) -> None:
    y, u = loop.process_value, loop.output
    by_hand = 50.0 + 1.5 * np.cumsum(np.arange(1500) % 40 == 0) * (np.arange(1500) < 700)
    held = np.repeat(np.round(u[::5], 4), 5)
    quiet = simulate(replace(preset("foptd"), duration_s=800.0), seed=1).loop
    for signal in (y, u, np.round(y, 2), in_steps(y, 2.0 * SETTING.noise_sd), in_steps(u, 0.25), by_hand, held,
                   quiet.output, np.round(quiet.output, 3)):
        assert archived(signal, (0,), y) is None
    # A controller that saw no noise draws smooth curves, with straight pieces where y rests.
    moving = simulate(Setting(Plant(1.5, 10.0, 3.0), Controller(0.4, 12.0), S=4.0, J=2.0, duration_s=700.0,
                              noise_sd=0.05, setpoint_moves=((0.0, 3.0), (350.0, -2.0))), seed=0).loop
    assert thinned_output(moving) is None
    for signal in (quiet.process_value, np.round(quiet.process_value, 3)):
        assert archived(signal, (0,), quiet.output) is None
    assert archived(np.full(200, 3.0)) is None and archived(np.full(200, np.nan)) is None


@pytest.mark.parametrize(("seed", "way"), [(7, "exception"), (10, "door")])
def test_filled_in_values_do_not_speak_against_friction(seed: int, way: str) -> None:
    """A valve that sticks is likelier by what was kept; over all rows the other one was, by 758 and 223."""
    setting = replace(setting_of(seed)[0], duration_s=1500.0)
    full = simulate(setting, seed=seed).loop
    thin = replace(full, process_value=lossy.lossy(full.process_value, way, 3.0 * setting.noise_sd), position=None)
    model = Model(thin, Spec(), s_max=float(np.ptp(thin.output)), period_s=60.0)
    true = {"S": setting.S, "J": setting.J, "initial_residual_force": 0.0,
            "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s}
    run = Run(thin, find_range(thin), Options(), law="chen", rng=np.random.default_rng(0),
              tell=lambda words, share: None)
    sticking, free = with_and_without(run, whiten_model(model, model.vector(true)))
    assert sticking.innovation_sd < 0.9 * free.innovation_sd
    assert gain_of_friction(sticking, free) > 40.0


def test_no_value_is_kept_across_a_gap(loop: Loop) -> None:
    thin = lossy.lossy(loop.process_value, "door", 3.0 * SETTING.noise_sd)
    joined = np.concatenate([thin, thin + 5.0])
    found = archived(joined, (0, thin.size))
    assert found is not None and found.kept[thin.size - 1] and found.kept[thin.size]


def exported(loop: Loop, folder: Path, way: str, tags: str, times: float) -> Path:
    deadband = times * SETTING.noise_sd
    y = lossy.lossy(loop.process_value, way, deadband) if "PV" in tags else loop.process_value
    u = lossy.lossy(loop.output, way, deadband * SETTING.controller.gain) if "OP" in tags else loop.output
    path = folder / "a.csv"
    np.savetxt(path, np.stack([loop.time_s, loop.setpoint, y, u], 1), fmt="%.6g", delimiter=",",
               header="time_s,SP,PV,OP", comments="")
    return path


@pytest.mark.parametrize(("way", "tags"), [("exception", "PV"), ("exception", "OP"), ("door", "PV"), ("door", "OP"),
                                           ("door", "PV and OP")])
def test_read_says_what_was_thinned(loop: Loop, tmp_path: Path, way: str, tags: str) -> None:
    found = {f.evidence["role"]: f for f in read(exported(loop, tmp_path, way, tags, 3.0)).findings
             if f.code in lossy.LOSSY}
    roles = {"PV": "process_value", "OP": "output"}
    assert set(found) == {role for tag, role in roles.items() if tag in tags}
    for tag, role in roles.items():
        if role in found:
            said = found[role]
            assert said.code == ("compressed" if way == "door" else "kept-by-exception")
            assert said.statement.startswith(f"{tag} is held") or f"of the {tag} samples" in said.statement
            assert said.evidence["deadband"] > 0.0 and not said.caps_verdict


@pytest.mark.parametrize("folder", ["sample_data", "../shared/real_loops"])
def test_records_of_plants_and_samples_are_not_called_lossy(folder: str) -> None:
    files = [p for p in sorted(Path(folder).glob("*")) if p.suffix in (".csv", ".txt", ".parquet")]
    if not files:
        pytest.skip(f"needs {folder}")
    for path in files:
        assert not {f.code for f in read_loop(path).origin.findings} & set(lossy.LOSSY), path.name


@pytest.mark.parametrize("times", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("way", WAYS)
def test_the_law_of_kept_values_gives_back_those_between(loop: Loop, way: str, times: float) -> None:
    deadband = times * SETTING.noise_sd * SETTING.controller.gain
    thin = replace(loop, output=np.round(lossy.lossy(loop.output, way, deadband), 4), position=None)
    law = controller_law(thin)
    assert law is not None and not surely_moves(thin)
    assert law.controller.gain == pytest.approx(SETTING.controller.gain, rel=1e-3)
    before, after = (float(np.sqrt(np.mean((u - loop.output)[5:] ** 2))) for u in (thin.output, law.command))
    assert before > 0.2 * deadband and after < 0.02 * deadband
    assert law.command_sd < 0.02 * unknown_step(thin)


def test_no_law_is_found_where_the_error_is_not_known(loop: Loop) -> None:
    deadband = 4.0 * SETTING.noise_sd
    both = replace(loop, process_value=lossy.lossy(loop.process_value, "door", deadband), position=None,
                   output=lossy.lossy(loop.output, "door", deadband * SETTING.controller.gain))
    assert controller_law(both) is None and thinned_output(both) is not None
    assert "because the historian thinned it" in said_rounding(both)
    # S compares two values of OP, and each may lag by a deadband.
    assert command_margin(both) == unknown_step(both) > command_margin(loop)
    assert command_margin(replace(both, followed="full", output_sd=0.01)) < 0.03


def test_s_comes_from_an_output_of_straight_lines(loop: Loop, tmp_path: Path) -> None:
    read_back = read_loop(exported(loop.cut(0, 1200), tmp_path, "door", "OP", 2.0))
    study = identify(read_back, options=Options(base_only=True, intervals=False))
    assert study.estimate is not None and abs(study.estimate.S / SETTING.S - 1.0) < 0.01
    assert study.controller is not None and study.controller.rebuilt
    said = next(f for f in study.data.findings if f.code == REBUILT)
    assert "straight lines of a historian" in said.statement


def test_a_held_peak_is_no_end_of_a_transmitter(loop: Loop) -> None:
    counted = get("measurement-limit").counted
    assert counted is not None
    y = loop.process_value
    thin = lossy.lossy(y, "exception", 5.0 * SETTING.noise_sd)
    assert counted(thin).all()
    assert not counted(np.minimum(y, np.quantile(y, 0.8))).all()


def test_straight_lines_are_no_prediction(loop: Loop) -> None:
    """Rows of a line predict each other, so that the noise is judged at the distance of the kept values."""
    y = lossy.lossy(loop.process_value, "door", 3.0 * SETTING.noise_sd)
    good = np.ones(y.size, bool)
    near, far = (irreducible_error(y, loop.output, good, 3, nearest=k) for k in (1, 10))
    assert near is not None and far is not None and near < 0.5 * SETTING.noise_sd < far


def test_only_kept_values_of_straight_lines_count(loop: Loop) -> None:
    """The lines themselves come back, and the floor is that of kept values with drawn ones in their past."""
    y = lossy.lossy(loop.process_value, "door", SETTING.noise_sd)
    found = measured_rows(replace(loop, process_value=y))
    kept = np.isin(np.arange(y.size), lossy.kept_by_door(loop.process_value, SETTING.noise_sd))
    assert np.array_equal(found.used, kept) and np.array_equal(np.isfinite(found.process_value), kept)
    drawn, length = drawn_lines(found)
    assert np.allclose(drawn, y, atol=1e-12) and length == round(y.size / kept.sum())
    assert found.position is not None
    floor = noise_floor(found, found.position, found.used, 3.0)
    assert floor is not None and 0.8 * SETTING.noise_sd < floor < 2.0 * SETTING.noise_sd
    # Values held after an exception and rows that nobody thinned stay, and a PV that is slower than OP has no lines.
    held = replace(loop, process_value=lossy.lossy(loop.process_value, "exception", SETTING.noise_sd))
    tenth = np.arange(y.size) % 10 == 0
    slower = replace(loop, process_value=np.where(tenth, loop.process_value, np.nan), used=tenth)
    for other in (loop, held, slower):
        assert measured_rows(other) is other and drawn_lines(other)[1] == 1


def test_the_choice_of_a_swinging_door_names_no_coloured_noise() -> None:
    errors = np.asarray(lfilter([1.0], [1.0, 0.5], 0.2 * np.random.default_rng(4).standard_normal(SAMPLES)))
    plain = recorded(errors)
    for drawn, name in ((False, COLOURED), (True, "")):
        assert noise_name(scored(replace(plain, drawn=drawn)), Policy()) == name
