"""The closed loop: the same bytes for a seed, truth files, scans, limits, refusals, sample_data regenerated."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stictionid.errors import StictionidError, UsageError
from stictionid.model.closed_loop import preset, simulate, with_stiction

ROOT = Path(__file__).parent.parent


def test_the_same_seed_gives_the_same_record_and_another_seed_another() -> None:
    setting = replace(preset("foptd"), noise_sd=0.1, duration_s=200)
    one, two, other = (simulate(setting, seed=s).loop for s in (1, 1, 2))
    assert (one.process_value == two.process_value).all() and (one.output == two.output).all()
    assert not (one.process_value == other.process_value).all()


def test_the_loop_starts_at_rest_and_settles_without_stiction() -> None:
    loop = simulate(with_stiction(preset("foptd"), 0.0, 0.0)).loop
    assert loop.position is not None and loop.setpoint is not None
    assert loop.process_value[0] == 50.0
    np.testing.assert_allclose(loop.position, loop.output)
    np.testing.assert_allclose(loop.process_value[-100:], 55.0, atol=1e-6)


def test_a_finer_integration_changes_little() -> None:
    setting = replace(with_stiction(preset("foptd"), 5.0, 3.5), duration_s=400)
    coarse, fine = simulate(setting).loop, simulate(replace(setting, fine_step_s=0.0125)).loop
    assert np.abs(coarse.process_value - fine.process_value).max() < 0.25


def test_a_scanning_controller_holds_its_output_between_scans() -> None:
    base = preset("foptd")
    setting = replace(base, step_s=0.25, duration_s=100, controller=replace(base.controller, scan_s=1.0))
    u = simulate(setting).loop.output
    assert (u.reshape(-1, 4) == u[::4, None]).all()
    assert np.unique(u).size > 50


def test_the_output_is_limited_without_winding_up() -> None:
    setting = replace(with_stiction(preset("foptd"), 1.0, 1.0), setpoint_moves=((0.0, 400.0), (300.0, -400.0)))
    u = simulate(setting).loop.output
    assert u.max() == 100.0 and u[330:].min() < 60.0


@pytest.mark.parametrize("change", [
    {"S": -1.0}, {"S": 2.0, "J": 5.0}, {"step_s": 0.0}, {"duration_s": -1.0}, {"law": "nobody"}, {"noise_sd": -0.1},
    {"S": float("nan")},
])
def test_values_out_of_range_are_refused_in_a_sentence(change: dict) -> None:
    with pytest.raises(StictionidError) as refusal:
        simulate(replace(preset("foptd"), **change))
    assert refusal.value.exit_code == 2 and refusal.value.hint


def test_a_refusal_names_the_limit_itself() -> None:
    for change, hint in (({"noise_sd": -0.1}, "give --noise 0 or more"), ({"step_s": 0.0}, "give --step 1e-06 or more"),
                         ({"step_s": 2.0, "duration_s": 1.0}, "give --duration 2 or more")):
        with pytest.raises(UsageError) as refusal:
            simulate(replace(preset("foptd"), **change))
        assert refusal.value.hint == hint


def test_sample_data_are_what_make_py_makes(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("make", ROOT / "sample_data" / "make.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for path in module.make(tmp_path):
        kept = ROOT / "sample_data" / path.name
        if path.suffix == ".parquet":  # the writer's version is part of the bytes; the numbers must agree
            import pyarrow.parquet as pq

            assert pq.read_table(kept).equals(pq.read_table(path))
        else:
            _alike(kept.read_text(), path.read_text(), path.name)


def _alike(kept: str, made: str, name: str) -> None:
    """Equal text, or on another processor's exp() equal numbers to the last few bits."""
    if kept == made:
        return
    assert name.endswith(".csv"), name
    ours, theirs = (np.genfromtxt(t.splitlines(), delimiter=",", skip_header=1) for t in (kept, made))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)
