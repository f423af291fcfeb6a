"""Laws that users write as one step in plain Python: template, contract test, search, and what a study remembers."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import HANGS_S, run
from loops_with_effects import MOVES, PLANTS

import stictionid.laws.contract.written as loader
from stictionid.batch.command import command_for
from stictionid.batch.task import Work
from stictionid.errors import DataError, StictionidError, UsageError
from stictionid.historian import ReadOptions
from stictionid.laws import VARIABLE, catalogue, forget, get, register, use
from stictionid.laws.contract.template import template
from stictionid.model.closed_loop import OPERATING_POINT, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.restore import rebuild_model
from stictionid.model.spec import Spec
from stictionid.model.valve_bench import TESTS, put_on_bench

# He's law as one step: the stem rests at every sample.
HE = '''"""The stem rests at every sample."""
def step(command, before, position, memory, f_s, f_d):
    force = command - position
    return position if abs(force) <= f_s else command - f_d if force > 0 else command + f_d
'''


@pytest.fixture(autouse=True)
def _clean(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing that a test has loaded stays."""
    monkeypatch.delenv(VARIABLE, raising=False)
    before = set(catalogue())
    yield
    for name in set(catalogue()) - before:
        forget(name)
    os.environ.pop(VARIABLE, None)


@pytest.fixture
def in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Laws are not compiled, which takes longer than these tests."""
    monkeypatch.setattr(loader, "_fast", lambda step: (None, "not in this test"))


def written(folder: Path, text: str, name: str = "my_law.py") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_law_of_one_step_is_the_built_in_one_and_takes_the_effects_on_friction(tmp_path: Path) -> None:
    points: list[str] = []
    (mine,) = use([written(tmp_path, HE)], points.append)
    assert points[-1] == "it compiles" and len(points) == 5
    he, rng = get("he"), np.random.default_rng(3)
    command = 50.0 + np.cumsum(rng.standard_normal(400)).round(2)
    table = he.friction(np.array([3.0, 2.0, 4.0]), np.array([1.0, 2.0, 0.5]))
    table[0, 1] *= 1.3  # harder to open
    table[4], table[8, 2], table[9, 2] = 0.2, 47.0, 52.0  # drift, stops
    profile = np.linspace(0.0, 1.0, command.size)
    found, want = (law.positions(command, table, profile=profile, share=0.4) for law in (mine, he))
    assert found == pytest.approx(want, abs=1e-8)
    # In Python, where numba can't compile, it is the same.
    space: dict[str, object] = {}
    exec(HE, space)
    slow = replace(mine, run=loader.kernel_of(space["step"]))  # type: ignore[arg-type]
    assert np.array_equal(slow.positions(command, table, profile=profile, share=0.4), found)


def test_the_template_keeps_the_contract_and_the_bench(tmp_path: Path, in_python: None) -> None:
    (law,) = use([written(tmp_path, template("dwell"))])
    assert law.summary.startswith("Valve whose static friction")
    outcomes = put_on_bench(law, S=5.0, J=3.0, tests=tuple(TESTS), values={})
    assert all(e.holds for o in outcomes for e in o.expectations)


def test_a_model_with_the_law_comes_back_and_remembers_its_file(tmp_path: Path, in_python: None) -> None:
    path = written(tmp_path, template("dwell"))
    use([path])
    setting = Setting(PLANTS[1][0], replace(PLANTS[1][1], scan_s=1.0), law="dwell", S=4.0, J=2.5, duration_s=500.0,
                      setpoint_moves=MOVES[:3], noise_sd=0.02)
    loop = simulate(setting, seed=4).loop
    errors = {}
    for law in ("dwell", "he"):
        model = Model(loop, Spec(law=law), s_max=float(np.ptp(loop.output)), period_s=40.0)
        at = model.vector({"S": 4.0, "J": 2.5, "time_constant_s": setting.plant.time_constant_s,
                           "initial_residual_force": (loop.output[0] - OPERATING_POINT) / 3.25,
                           "dead_time_s": setting.plant.dead_time_s})
        errors[law] = model.evaluate(at).rmse
        if law == "dwell":
            description = model.describe(at)
    assert errors["dwell"] == pytest.approx(0.02, rel=0.1) and errors["he"] > 2.0 * errors["dwell"]
    assert description["written_law"] == {"file": str(path), "sha256": get("dwell").sha256}
    again, values = rebuild_model(loop, description)
    assert again.evaluate(values).rmse == errors["dwell"]
    forget("dwell")
    with pytest.raises(DataError, match=r"the law dwell of .*my_law.py, which is not loaded"):
        rebuild_model(loop, description)
    plain = command_for("a.csv", Work(), ReadOptions())
    use([written(tmp_path, template("dwell") + "\n# another day\n")])
    with pytest.raises(DataError, match="has changed since the study was made"):
        rebuild_model(loop, description)
    assert command_for("a.csv", Work(), ReadOptions()) == f"{plain} # law dwell {get('dwell').sha256[:12]}"


@pytest.mark.parametrize(("text", "said"), [
    ("def step(:\n", r"my_law.py:1: it does not compile"),
    ("import nothing_here\n", r"my_law.py:1: it can't be imported"),
    ("NAME = 'chen'\n" + HE, r"my_law.py:1: NAME chen is that of a built-in law"),
    ("MEMORY = 'x'\n" + HE, r"my_law.py:1: MEMORY is 'x', not up to 64 numbers"),
    ("x = 1\n", r"defines no function step; write def step\(command, before"),
    ("def step(command, position):\n    return position\n", r"my_law.py:1: step\(\) does not take its arguments"),
    ("def step(c, b, p, m, s, d):\n    return p / 0\n", r"my_law.py:2: step\(\) fails \(ZeroDivisionError"),
    ("def step(c, b, p, m, s, d):\n    return float('nan')\n", "returns NaN or infinity at S = 5 and J = 2 %"),
    ("def step(c, b, p, m, s, d):\n    return p\n", "further from the command than f_s"),
    ("def step(c, b, p, m, s, d):\n    return p + 0.5 * (c - p) if abs(c - p) < s else c\n", "while the command rests"),
    ("n = [0]\ndef step(c, b, p, m, s, d):\n    n[0] += 1\n    return c - 1e-3 * d * (n[0] % 7)\n", "other numbers"),
    ("def step(c, b, p, m, s, d):\n    return c - 0.01\n", "at S = J = 0 it follows"),
    ("def step(c, b, p, m, s, d):\n    while True:\n        pass\n", "it still runs after"),
])
def test_a_file_that_breaks_the_contract_is_refused_in_one_line(text: str, said: str, tmp_path: Path,
                                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    get("he").friction(3.0, 1.0)  # its kernel is loaded before the clock runs
    if "while True" in text:
        monkeypatch.setattr("stictionid.laws.contract.written.load.__defaults__", ((), None, 0.3))
    with pytest.raises(StictionidError, match=said) as refused:
        use([written(tmp_path, text)])
    assert "\n" not in refused.value.message and "my_law" not in catalogue()


def test_a_law_that_numba_cannot_compile_runs_in_python(tmp_path: Path) -> None:
    points: list[str] = []
    (law,) = use([written(tmp_path, HE.replace("    force =", "    {}.setdefault(None, object())\n    force ="))],
                 points.append)
    assert "some 100 times slower" in points[-1]
    command = np.array([50.0, 54.0, 50.0, 46.0])
    assert law.positions(command, law.friction(3.0, 1.0))[:, 0] == pytest.approx([50.0, 53.0, 51.0, 47.0])


def test_laws_come_from_the_environment_and_from_python(tmp_path: Path, in_python: None) -> None:
    written(tmp_path, HE, "rests.py")
    plain = {**os.environ, VARIABLE: str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-m", "stictionid", "laws", "rests"], capture_output=True, text=True,
                          env=plain, timeout=HANGS_S)
    assert done.returncode == 0 and "user-written" in done.stdout, done.stderr
    use([tmp_path])
    register(replace(get("rests"), name="resting-again", file="", sha256=""))
    assert get("resting-again").run is get("rests").run
    with pytest.raises(UsageError, match="is that of a built-in law"):
        register(get("chen"))


def test_the_command_writes_checks_and_shows(tmp_path: Path, in_python: None) -> None:
    def said(*arguments: object) -> str:
        done = run("laws", *arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    assert "next: stictionid laws --check mine.py" in said("--new", "dwell", "-o", "mine.py")
    assert len((tmp_path / "mine.py").read_text().splitlines()) <= 40
    assert "mine.py keeps the contract" in said("--check", "mine.py")
    assert "user-written, mine.py" in said("dwell", "--laws", "mine.py")
    (tmp_path / "bad.py").write_text("def step(c, b, p, m, s, d):\n    return p\n")
    refused = run("laws", "--check", "bad.py", cwd=tmp_path)
    assert refused.returncode == 3 and "bad.py:1: step()" in refused.stderr
