"""Effects that users write in plain numpy: template, contract test, adapter, loader, and what a study remembers."""

from __future__ import annotations

import json
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

from stictionid.batch.command import command_for
from stictionid.batch.task import Work
from stictionid.cli.common.output import Progress
from stictionid.effects import VARIABLE, catalogue, forget, get, register, use
from stictionid.effects.contract import Context
from stictionid.effects.contract.written import SLOW
from stictionid.errors import DataError, StictionidError, UsageError
from stictionid.historian import ReadOptions
from stictionid.model.closed_loop import OPERATING_POINT, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.restore import rebuild_model
from stictionid.model.spec import Spec
from stictionid.system import evaluations
from stictionid.system.user_code import limited

WIDTH = 'PARAMETERS = {"width": {"unit": "%", "range": (0, 20), "neutral": 0}}\n'
# A second lag in four ways: a loop in Python, an array function, transfer function, state space.
TIME = 'PARAMETERS = {"T": {"unit": "s", "range": (0, 20), "neutral": 0}}\n'
LOOPED = TIME + """def process(input, time_s, T):
    out, x, dt = input.copy(), 0.0, time_s[1] - time_s[0] if len(time_s) > 1 else 1.0
    if T == 0:
        return out
    keep = 2.718281828459045 ** (-dt / T)
    for k in range(len(input)):
        mean = input[k] + (x - input[k]) * T / dt * (1 - keep)
        x = input[k] + (x - input[k]) * keep
        out[k] = mean
    return out
"""
TRANSFER = TIME + "def tf(T):\n    return [1.0], [T, 1.0]\n"
STATES = TIME + "def ss(T):\n    a = 1.0 / max(T, 1e-6)\n    return [[-a]], [a], [1.0], [0.0]\n"


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
def worn(tmp_path: Path) -> Path:
    """The template as a file."""
    path = tmp_path / "my_effect.py"
    assert run("effects", "--new", "worn-trim", "-o", path).returncode == 0
    return path


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def loop_with(name: str, values: dict, seed: int = 4, **more):
    setting = Setting(PLANTS[1][0], replace(PLANTS[1][1], scan_s=1.0), S=4.0, J=2.5, duration_s=500.0,
                      setpoint_moves=MOVES[:3], effects=((name, values),))
    setting = replace(setting, **more)
    return setting, simulate(setting, seed=seed).loop


def model_at(loop, setting: Setting, *effects: str, **values: float) -> tuple[Model, np.ndarray]:
    """A model of a simulated loop at the true values."""
    model = Model(loop, Spec(effects=effects), s_max=float(np.ptp(loop.output)), period_s=40.0)
    force = (loop.output[0] - OPERATING_POINT) / (0.5 * (setting.S + setting.J))
    return model, model.vector({
        "S": setting.S, "J": setting.J, "initial_residual_force": force, "dead_time_s": setting.plant.dead_time_s,
        "time_constant_s": setting.plant.time_constant_s, **{f"{effects[0]}:{k}": v for k, v in values.items()}})


def test_the_template_is_short_keeps_the_contract_and_is_listed(worn: Path) -> None:
    assert len(worn.read_text().splitlines()) <= 40
    done = run("effects", "--check", worn)
    said = " ".join(done.stdout.split())  # lines break where the path to the file ends
    assert done.returncode == 0 and "keeps the contract" in said and "vanishes" in said
    shown = run("effects", "worn-trim", "--effects", worn, "--json")
    found = json.loads(shown.stdout)[0]
    assert found["file"] == str(worn) and [p["name"] for p in found["parameters"]] == ["start", "width"]
    assert run("effects", "--new", "worn-trim", "-o", worn).returncode == 2
    assert run("effects", "--new", "extra-lag", "-o", worn.with_name("x.py")).returncode == 2


def test_a_worn_trim_holds_the_flow_and_its_true_model_leaves_nothing(worn: Path) -> None:
    use([worn])
    values = {"start": 49.0, "width": 2.0}
    setting, loop = loop_with("worn-trim", values)
    model, at = model_at(loop, setting, "worn-trim", **values)
    without, there = model_at(loop, setting, "worn-trim", start=49.0, width=0.0)
    assert model.evaluate(at).rmse < 1e-3 * np.ptp(loop.process_value) < without.evaluate(there).rmse
    costs = model.costs_of(np.stack([at, there, at], axis=1))
    assert costs[0] == costs[2] < costs[1]


@pytest.mark.parametrize("text", [TRANSFER, STATES], ids=["transfer function", "state space"])
def test_a_second_lag_written_in_any_form_is_the_built_in_one(tmp_path: Path, text: str) -> None:
    """One that is written as a function is in benchmarks/long."""
    use([written(tmp_path, 'NAME = "slow-sensor"\n' + text)])
    setting, loop = loop_with("slow-sensor", {"T": 4.0})
    want = loop_with("extra-lag", {"second_time_constant_s": 4.0})[1]
    # A function is advanced by quarters of a sample in a simulation, coefficients exactly.
    near = 0.06 if "process" in text else 2e-3
    np.testing.assert_allclose(loop.process_value, want.process_value, atol=near * np.ptp(want.process_value))
    model, at = model_at(want, setting, "slow-sensor", T=4.0)
    built_in, there = model_at(want, setting, "extra-lag", second_time_constant_s=4.0)
    wave = model.evaluate(at).model, built_in.evaluate(there).model
    np.testing.assert_allclose(*wave, atol=(0.02 if "process" in text else 1e-6) * np.ptp(want.process_value))


def test_columns_of_a_disturbance_are_fitted_and_reported(tmp_path: Path) -> None:
    use([written(tmp_path, '"""Two humps."""\nimport numpy as np\nNAME = "humps"\nPARAMETERS = {"at": {"unit": "s", '
                 '"range": (0, 500), "neutral": 0}}\ndef disturbance(time_s, at):\n    hump = lambda t: '
                 'np.exp(-((time_s - t) / 20) ** 2)\n    return np.stack([hump(at), hump(at + 100)], axis=1)\n')])
    effect = get("humps")
    assert [p.name for p in effect.parameters] == ["at", "size_1", "size_2"] and effect.searched == ("at",)
    setting, loop = loop_with("humps", {"at": 200.0, "size_1": 1.5, "size_2": -0.7})
    model, at = model_at(loop, setting, "humps", at=200.0)
    found = model.evaluate(at)
    assert found.rmse < 1e-3 * np.ptp(loop.process_value)
    said = effect.public_values({"at": 200.0}, model.sizes_of("humps", at, found.own), {})
    assert said["size_1"] == pytest.approx(1.5, rel=0.01) and said["size_2"] == pytest.approx(-0.7, rel=0.02)


def test_a_function_is_called_once_for_all_candidates_only_where_that_is_the_same(worn: Path, tmp_path: Path) -> None:
    use([worn, written(tmp_path, 'NAME = "scalar"\n' + WIDTH + "def valve(position, time_s, width):\n    "
                       "return position - (width if position.mean() > 49 else 0)\n")])
    assert get("worn-trim").lanewise and not get("worn-trim").memory  # type: ignore[attr-defined]
    assert not get("scalar").lanewise and get("scalar").memory  # type: ignore[attr-defined]


def test_a_slow_effect_is_called_slow_and_its_search_shows_that_it_goes_on(
        worn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    use([worn, written(tmp_path, 'NAME = "slow-sensor"\n' + LOOPED)])
    assert get("worn-trim").slower < SLOW < get("slow-sensor").slower
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Progress(quiet=False) as progress:
        progress("refitting", 0.1)
        for now[0] in (4.0, 6.0, 8.0, 12.0, 70.0):
            evaluations.add(1, 1)
    evaluations.add(1, 1)
    first, *lines = capsys.readouterr().err.splitlines()
    assert "slow-sensor is plain Python" in first and "worn-trim" not in first
    assert lines == ["refitting, 10 % after 6 s", "refitting, 10 % after 70 s"]


def test_a_candidate_without_finite_numbers_is_rejected(tmp_path: Path) -> None:
    use([written(tmp_path, 'NAME = "fragile"\n' + WIDTH + "import numpy as np\ndef valve(position, time_s, width):\n"
                 "    return np.where(abs(width - 7.7) < 1e-6, np.nan, position)\n")])
    setting, loop = loop_with("extra-lag", {})
    model, at = model_at(loop, setting, "fragile", width=7.7)
    fine = at.copy()
    fine[-1] = 3.0
    costs = model.costs_of(np.stack([at, fine], axis=1))
    assert np.isinf(costs[0]) and np.isfinite(costs[1])


@pytest.mark.parametrize(("line", "said", "text"), [
    (2, "does not compile", WIDTH + "def valve(position time_s, width):\n    return position\n"),
    (1, "can't be imported", "import no_such_package_here\n"),
    (1, "can't be imported", "raise SystemExit(0)\n"),
    (2, "NaN", WIDTH + "def valve(p, t, width):\n    return p if width == 0 else p * float('nan')\n"),
    (3, "changes its input", WIDTH + "def valve(p, t, width):\n    p += width\n    return p\n"),
    (2, "correct neutral in PARAMETERS", WIDTH + "def valve(position, time_s, width):\n    return 0.9 * position\n"),
    (2, "take the rate 1/tau as the parameter, neutral 0",
     'PARAMETERS = {"tau": {"unit": "s", "range": (10, 1e9), "neutral": 1e9, "log": True}}\n'
     "def valve(position, time_s, tau):\n    return position * 2.718281828 ** (-time_s / tau)\n"),
    (2, "take the rate 1/gap as the parameter, neutral 0",
     'PARAMETERS = {"gap": {"unit": "s", "range": (10, 100), "neutral": 100}}\n'
     "def tf(gap):\n    return [5 - 5 / gap, 1], [5, 1]\n"),
    (1, "built-in", 'NAME = "extra-lag"\n' + WIDTH + "def valve(position, time_s, width):\n    return position\n"),
    (1, "is no name", 'NAME = "Extra Lag"\n' + WIDTH + "def valve(position, time_s, width):\n    return position\n"),
    (2, "returns shape (239,)", WIDTH + "def valve(position, time_s, width):\n    return position[1:]\n"),
    (2, "array of numbers", WIDTH + "def valve(position, time_s, width):\n    return 'open'\n"),
    (2, "does not take its arguments", WIDTH + "def valve(position, time_s):\n    return position\n"),
    (3, "IndexError", WIDTH + "def valve(position, time_s, width):\n    return position + [][0]\n"),
    (1, "need unit, range and neutral", 'PARAMETERS = {"width": (0, 20)}\ndef valve(p, t, width):\n    return p\n'),
    (1, "does not hold neutral", WIDTH.replace("(0,", "(1,") + "def valve(p, t, width):\n    return p\n"),
    (1, "none of valve", "x = 1\n"),
    (1, "valve and process", WIDTH + "def valve(p, t, width):\n    return p\nprocess = valve\n"),
    (3, "other numbers", WIDTH + "import numpy\ndef valve(p, t, width):\n    return p + numpy.random.rand(p.size)\n"),
    (2, "gain of 2", TIME + "def tf(T):\n    return [2.0], [T, 1.0]\n"),
    (2, "higher order", TIME + "def tf(T):\n    return [T, 1.0], [1.0]\n"),
    (2, "don't fit", TIME + "def ss(T):\n    return [[-1.0]], [1.0, 2.0], [1.0], [0.0]\n"),
    (2, "input rests at 0", TIME + "def process(x, t, T):\n    return x + T\n"),
    (2, "complex", WIDTH + "def valve(p, t, width):\n    return p - 1j * width\n"),
    (1, "CONFUSED_WITH", "CONFUSED_WITH = 'extra-lag'\n" + WIDTH + "def valve(p, t, width):\n    return p - width\n"),
    (2, "returns NaN", WIDTH + "def disturbance(t, width):\n    return t * float('nan')\n"),
    (2, "other columns", WIDTH + "def disturbance(t, width):\n    return t[:, None].repeat(1 + (width > 1), axis=1)\n"),
    (2, "does not settle", TIME + "def tf(T):\n    return [1.0], [-T, 1.0]\n"),
    (2, "does not settle", TIME + "def ss(T):\n    return [[0.0]], [1.0], [1.0], [0.0]\n"),
    (4, "names widht", WIDTH + "def valve(p, t, width):\n    return p - width\ndef guess(record):\n"
     "    return {'widht': 3.0}\n"),
    (5, "read-only", WIDTH + "def valve(p, t, width):\n    return p - width\ndef guess(record):\n"
     "    record.command[:] = 0.0\n"),
    (5, "guess() fails", WIDTH + "def valve(p, t, width):\n    return p - width\ndef guess(record):\n"
     "    return record.nothing\n"),
])
def test_a_file_that_breaks_the_contract_is_refused_in_a_line(tmp_path: Path, line: int, said: str, text: str) -> None:
    path = written(tmp_path, text)
    for words in (("effects", "--check", path), ("simulate", "--effects", path, "-o", tmp_path / "x.csv")):
        done = run(*words)
        assert done.returncode == 3 and done.stdout.replace("ok:", "").count("Traceback") == 0
        assert done.stderr.count("\n") == 1 and f"{path}:{line}: " in done.stderr and said in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.py"]


def test_code_that_does_not_end_is_stopped_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, "def f():\n    while True:\n        pass\n")
    code = compile(path.read_text() + "f()\n", str(path), "exec")
    with pytest.raises(DataError, match=r"mine.py:[23]: it still runs after 0.1 s"), limited(0.1, str(path)):
        exec(code, {})
    traced = sys.gettrace()
    caught = "while True:\n    try:\n        sum(range(999))\n    except:\n        pass\n"
    for text in (caught, caught.replace("except", "except Exception")):
        with pytest.raises(DataError, match=r"mine.py:\d: it still runs after 0.1 s"), limited(0.1, str(path)):
            exec(compile(text, str(path), "exec"), {})
    assert sys.gettrace() is traced


def test_a_fault_in_a_search_names_file_and_line(tmp_path: Path) -> None:
    use([written(tmp_path, 'NAME = "late"\n' + WIDTH + "def valve(position, time_s, width):\n"
                 "    if position.size > 400:\n        return position / None\n    return position\n")])
    setting, loop = loop_with("extra-lag", {})
    model, at = model_at(loop, setting, "late", width=2.0)
    with pytest.raises(DataError, match=r"mine.py:5: valve\(\) fails \(TypeError"):
        model.costs_of(at[:, None])


def shown(name: str, **env: object) -> subprocess.CompletedProcess[str]:
    """An effect as a new process shows it in this environment: a process looks only once for what that brings."""
    return subprocess.run([sys.executable, "-m", "stictionid", "effects", name, "--json"], capture_output=True,
                          text=True, env={**os.environ, **{k: str(v) for k, v in env.items()}}, timeout=HANGS_S)


def test_the_environment_names_files_and_folders(worn: Path) -> None:
    found = shown("worn-trim", **{VARIABLE: worn.parent})
    assert found.returncode == 0 and json.loads(found.stdout)[0]["file"] == str(worn)
    refused = shown("worn-trim", **{VARIABLE: worn.parent / "nothing.py"})
    assert refused.returncode == 2 and "no effect file" in refused.stderr and "nothing.py" in refused.stderr


def test_an_installed_package_brings_effects(worn: Path) -> None:
    folder = worn.parent / "site" / "trims-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: trims\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[stictionid.effects]\nworn = trims_worn\n")
    (folder.parent / "trims_worn.py").write_text(worn.read_text().replace("worn-trim", "packed-trim"))
    places = os.pathsep.join([str(folder.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    found = shown("packed-trim", PYTHONPATH=places)
    assert found.returncode == 0 and json.loads(found.stdout)[0]["name"] == "packed-trim"


def test_an_effect_is_registered_in_python_unless_its_name_is_built_in() -> None:
    mine = replace(get("extra-lag"), name="my-lag")
    register(mine)
    assert get("my-lag") is mine and "my-lag" in catalogue()
    with pytest.raises(UsageError, match="built-in"):
        register(get("extra-lag"))
    forget("my-lag")
    with pytest.raises(StictionidError, match="unknown effect 'my-lag'"):
        get("my-lag")


def test_two_files_of_one_name_are_refused_and_an_edited_one_is_read_again(worn: Path) -> None:
    use([worn])
    first = get("worn-trim")
    other = written(worn.parent, worn.read_text() + "# another\n", "other.py")
    with pytest.raises(DataError, match=r"other\.py:1: NAME worn-trim is that of .*my_effect\.py"):
        use([other])
    worn.write_text(worn.read_text() + "# edited\n")
    use([worn])
    assert get("worn-trim").sha256 != first.sha256


def test_a_model_remembers_file_and_hash_and_is_not_rebuilt_without(worn: Path) -> None:
    use([worn])
    setting, loop = loop_with("worn-trim", {"start": 49.0, "width": 2.0})
    model, at = model_at(loop, setting, "worn-trim", start=49.0, width=2.0)
    description = json.loads(json.dumps(model.describe(at)))
    assert description["written"]["worn-trim"] == {"file": str(worn), "sha256": get("worn-trim").sha256}
    again, values = rebuild_model(loop, description)
    assert np.array_equal(again.evaluate(values).model, model.evaluate(at).model)
    worn.write_text(worn.read_text() + "# edited\n")
    use([worn])
    with pytest.raises(DataError, match="has changed since the study was made"):
        rebuild_model(loop, description)
    forget("worn-trim")
    with pytest.raises(DataError, match=r"holds the effect worn-trim of .*my_effect\.py, which is not loaded"):
        rebuild_model(loop, description)
    plain, there = model_at(loop, setting, "extra-lag", second_time_constant_s=1.0)
    assert "written" not in plain.describe(there)


def test_guesses_are_the_users_or_spread_over_the_ranges(worn: Path, tmp_path: Path) -> None:
    use([worn, written(tmp_path, 'NAME = "spread"\n' + WIDTH + "def valve(p, t, width):\n    return p - width\n")])
    wave = 50.0 + 10.0 * np.sin(np.arange(200) / 9.0)
    context = Context(wave, wave, None, 1.0, 60.0, 8.0)
    guess, spread = get("worn-trim").guess, get("spread").guess
    assert guess is not None and spread is not None
    assert guess(context).shape == (10, 2) and 40.0 < guess(context)[:, 0].min() < guess(context)[:, 0].max() < 60.0
    assert spread(context)[:, 0] == pytest.approx([3.0, 10.0, 17.0])


def test_a_batch_is_done_again_where_an_effect_file_has_changed(worn: Path, tmp_path: Path) -> None:
    """The command that a study remembers, and that --resume compares, holds the file's fingerprint."""
    def command() -> str:
        return command_for("a.csv", Work(), ReadOptions())

    plain = command()
    use([worn])
    before = command()
    assert before.startswith(plain) and f"# effect worn-trim {get('worn-trim').sha256[:12]}" in before
    forget("worn-trim")
    assert command() == plain
    use([written(tmp_path, worn.read_text() + "# another day\n", "my_effect.py")])
    assert command() not in (plain, before)
