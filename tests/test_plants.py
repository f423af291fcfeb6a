"""Plants of benchmarks/plants: independence and physics of the simulator, balance of the design, words of the table.

The same record for the same seed is in benchmarks/long.
"""

from __future__ import annotations

import ast
import json
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from plants.beyond import EFFECTS as BEYOND
from plants.design import EFFECTS, FACTORS, design, pairs, plain, possible
from plants.draw import turns
from plants.score import ALIKE, EXACT, WRONG, named_right
from plants.simulate import (
    INERTIAL,
    RESTING,
    SLIDING,
    Controller,
    Noise,
    Process,
    Setting,
    Valve,
    innovation_sd,
    simulate,
)
from plants.table import print_table, rows_of, wilson

from stictionid.effects import catalogue

ROOM = Path(__file__).resolve().parent.parent / "benchmarks" / "plants"
STICKY = Valve(5.0, 3.0)


def test_simulator_imports_nothing_of_the_package():
    for name in ("simulate.py", "design.py", "draw.py", "beyond.py"):
        found = set()
        for node in ast.walk(ast.parse((ROOM / name).read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module)
            elif isinstance(node, ast.ImportFrom):
                assert node.module in ("simulate", "design")
        outside = {module for module in found if module.partition(".")[0] in ("stictionid", "importlib")}
        assert not outside, f"{name} imports {outside}"


def test_all_effects_of_the_catalogue_are_hidden_somewhere():
    asked = {name for name, effect in catalogue().items() if effect.asked == "diagnose"}
    assert {plain(name) for name in EFFECTS} | set(BEYOND) >= asked


def _load_step(process: Process, lag: dict) -> np.ndarray:
    """Response of y to a load step of 2 % at 10 s, without controller and friction."""
    hidden = {"step-disturbance": {"time_s": 10.0, "size": 2.0, "at": "load"}, **lag}
    return simulate(Setting(process, Controller(0.0), Valve(0.0, 0.0), np.full(80, 50.0), effects=hidden)).y - 50.0


def test_responses_equal_the_analytic_ones():
    t = np.maximum(np.arange(80) - 10.0 - 3.5, 0.0)
    first = _load_step(Process(1.5, 8.0, 3.5), {})
    assert np.allclose(first, 3.0 * (1.0 - np.exp(-t / 8.0)), atol=1e-9)
    second = 3.0 * (1.0 - (8.0 * np.exp(-t / 8.0) - 3.0 * np.exp(-t / 3.0)) / 5.0)
    assert np.allclose(_load_step(Process(1.5, 8.0, 3.5, 3.0), {}), second, atol=1e-9)
    assert np.allclose(_load_step(Process(1.5, 8.0, 3.5), {"extra-lag": {"second_time_constant_s": 3.0}}), second,
                       atol=1e-9)
    ramp = 0.1 * (t - 8.0 * (1.0 - np.exp(-t / 8.0)))
    assert np.allclose(_load_step(Process(0.05, 8.0, 3.5, 0.0, True), {}), ramp, atol=1e-9)


def _triangle(valve: Valve, moving: bool, effects: dict | None = None):
    """Command and stem while the command goes slowly up and down; the process does not answer."""
    up = np.linspace(50.0, 70.0, 1001)[:-1]
    wave = np.concatenate([up, up[::-1], up, up[::-1]])
    record = simulate(Setting(Process(1e-9, 5.0, 1.0), Controller(1.0), valve, wave, moving, True,
                              effects=effects or {}))
    return record.command, record.stem


@pytest.mark.parametrize("kind", [SLIDING, RESTING, INERTIAL])
@pytest.mark.parametrize("moving", [False, True])
def test_stem_shows_stickband_and_slip_jump(kind, moving):
    u, x = _triangle(STICKY._replace(kind=kind, stribeck=0.001, inertia_s=0.004), moving)
    steps = np.abs(np.diff(x))
    # At the turn in the middle of the record: the first slip back.
    slip = 2000 + int(np.argmax(steps[2000:] > 1.0))
    if kind == SLIDING:
        assert u[2000] - u[slip + 1] == pytest.approx(-5.0, abs=0.05)
        assert steps[slip] == pytest.approx(3.0, abs=0.06)
    jumps = steps[steps > 1.0]
    assert np.median(jumps) == pytest.approx(3.0, abs=0.06)
    gap = np.abs(u - x)
    assert gap.max() == pytest.approx(4.0, abs=0.06)
    if kind == RESTING:
        assert np.all((steps < 1e-9) | (steps > 2.9))
    if kind == SLIDING:
        assert np.median(gap[900:1000]) == pytest.approx(1.0, abs=0.02)


def test_hidden_effects_act_on_the_stem():
    _, x = _triangle(STICKY, False, {"travel-limit": {"upper": 60.0}})
    assert x.max() == 60.0
    _, x = _triangle(STICKY, False, {"slew-limit": {"rate": 0.4}})
    assert np.abs(np.diff(x)).max() == pytest.approx(0.4)
    _, x = _triangle(STICKY._replace(kind=RESTING), False, {"slip-overshoot": {"overshoot": 1.5}})
    assert np.median(np.abs(np.diff(x))[np.abs(np.diff(x)) > 1.0]) == pytest.approx(4.5, abs=0.06)
    _, x = _triangle(STICKY._replace(kind=RESTING), False, {"asymmetric-stiction": {"jump_up": 4.0, "jump_down": 2.0}})
    moves = np.diff(x)
    assert np.median(moves[moves > 0.5]) == pytest.approx(4.0, abs=0.06)
    assert np.median(moves[moves < -0.5]) == pytest.approx(-2.0, abs=0.06)
    _, x = _triangle(STICKY, False, {"re-sticking": {"restick_speed": 1.0}})
    assert np.median(np.abs(np.diff(x))[np.abs(np.diff(x)) > 1e-9]) == pytest.approx(3.0, abs=0.06)
    _, x = _triangle(STICKY._replace(kind=RESTING), False,
                     {"stiction-drift": {"stickband_growth": 0.0, "jump_growth": -0.25}})
    moves = np.abs(np.diff(x))
    sizes = moves[moves > 0.5]
    assert sizes[-1] - sizes[0] == pytest.approx(-0.25 * (np.flatnonzero(moves > 0.5)[-1]
                                                         - np.flatnonzero(moves > 0.5)[0]) / 1000.0, abs=0.06)


def test_innovations_of_the_noise():
    flat = np.full(10, 50.0)

    def made(**more):
        return innovation_sd(Setting(Process(1.0, 5.0, 1.0), Controller(1.0), STICKY, flat, **more))
    assert made(noise=Noise(0.3)) == pytest.approx(0.3, rel=1e-6)
    assert made(noise=Noise(0.0, 0.5, 0.8), export=5) == pytest.approx(0.5 * 0.6, rel=1e-3)
    # A walk of q beside white noise of r: the steady Kalman filter's innovations.
    q, r = 0.2**2, 0.3**2
    steady = 0.5 * (q + np.sqrt(q * q + 4.0 * q * r)) + r
    assert made(noise=Noise(0.3), effects={"random-walk-disturbance": {"innovation_sd": 0.2}}) \
        == pytest.approx(np.sqrt(steady), rel=1e-3)


@pytest.mark.parametrize("kind", ["clean", "one", "two"])
def test_design_is_balanced_and_grows(kind):
    rows = design(kind, 72, 11)
    for factor, levels in FACTORS.items():
        used = Counter(row[factor] for row, _ in rows)
        assert max(used.values()) - min(used[level] for level in levels) <= 3, (factor, used)
    both = Counter(pair for row, _ in rows for pair in combinations(row.items(), 2))
    for (a, first), (b, second) in combinations(FACTORS.items(), 2):
        for pair in ((x, y) for x in first for y in second):
            never = (a, b, *pair) == ("excitation", "controller", "steady", "P")
            assert never or both[(a, pair[0]), (b, pair[1])] > 0, (a, b, pair)
    assert all(possible(row, effects) for row, effects in rows)
    hidden = Counter(name for _, effects in rows for name in effects)
    if kind != "clean":
        assert set(hidden) == set(EFFECTS) and max(hidden.values()) - min(hidden.values()) <= 2
    assert rows[:5] == design(kind, 5, 11)
    assert rows[:5] != design(kind, 5, 12)


def test_pairs_can_be_told_apart():
    assert len(pairs()) > 100
    assert not any({plain(a), plain(b)} == {"valve-characteristic", "gain-nonlinearity"} for a, b in pairs())


def test_turns_counts_reversals_beyond_a_threshold():
    assert turns(np.array([0.0, 1.0, 0.9, 2.0, 0.0, 3.0]), 0.5) == 2


def test_words_of_an_answer():
    step, hold = ["step-disturbance@load"], {"re-sticking"}
    assert named_right(step, hold, ["step-disturbance"], [], []) == EXACT
    assert named_right(step, hold, ["step-disturbance@output", "re-sticking"], [], []) == EXACT
    assert named_right(step, hold, ["step-disturbance", "extra-lag"], [], []) == WRONG
    assert named_right(step, hold, ["ramp-disturbance"], [("step-disturbance", "ramp-disturbance")], []) == ALIKE
    assert named_right(step, hold, ["ramp-disturbance"], [], []) == WRONG
    assert named_right(step, hold, ["slew-limit"], [], [["step-disturbance"]]) == ALIKE
    assert named_right(step, hold, ["re-sticking"], [], []) == WRONG
    assert named_right([], hold, ["re-sticking"], [], []) == EXACT
    assert named_right([], set(), ["re-sticking"], [], []) == WRONG
    assert named_right([], set(), [], [], []) == EXACT


def test_table_counts_by_family(tmp_path):
    levels, _ = design("clean", 1, 1)[0]
    base = {"kind": "one", "seed": 1, "levels": levels, "hidden": ["extra-lag"]}
    good = {**base, "loop": 0, "right": "exact", "answer": ["extra-lag"], "cpu_s": 2.0, "S_good": True, "J_good": True,
            "error_good": True, "S_error": 0.0, "J_error": 0.0, "error_over_noise": 1.0}
    rows = [good, {**base, "loop": 1, "out": "unidentifiable"},
            {**base, "loop": 2, "right": "wrong", "answer": [], "error": "DataError: short", "cpu_s": 4.0}]
    file = tmp_path / "rows.jsonl"
    file.write_text("".join(json.dumps(r) + "\n" for r in rows) + '{"cut')
    said: list[str] = []
    print_table(rows_of(file), said.append)
    assert said[0] == "3 loops, 2 scored, 1 unidentifiable"
    assert said[2].split()[:5] == ["all", "2", "1", "1", "0"]
    assert any(line.startswith("wrong one 2") and "DataError: short" in line for line in said)
    assert wilson(0, 0) == (0.0, 1.0)
    low, high = wilson(38, 40)
    assert (low, high) == (pytest.approx(0.865, abs=0.01), pytest.approx(0.983, abs=0.01))
