"""Diagnose and add: hidden effects are named first, the base is corrected first, clean loops stay unchanged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from quick_loops import PLAIN, asked_only
from real_nodes import model_on, recorded, scored

import stictionid.effects as effect_room
from stictionid.effects import get as get_effect
from stictionid.effects.contract import Context
from stictionid.errors import DataError, UsageError
from stictionid.fit.noise.completion import complete_model, complete_quickly
from stictionid.fit.noise.whiteness import passes_tests
from stictionid.fit.points.fitted import as_it_stands
from stictionid.historian import read_loop
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import Spec, own_taps
from stictionid.numerics.narrow_band import resonance, shape
from stictionid.record.loop import Loop
from stictionid.record.study import Study, to_json
from stictionid.record.write import write_loop
from stictionid.selection.bootstrap import p_of
from stictionid.selection.policy import Policy
from stictionid.selection.search import Search
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import Options, data_record, identify

HELD = Options(base_only=True, between="hold")
MOVES = ((0.0, 3.0), (200.0, -4.0), (450.0, 5.0), (700.0, -3.0))


FEW = ("step-disturbance", "extra-lag")


def setting(**more) -> Setting:
    base = Setting(Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0, scan_s=1.0), S=4.0, J=2.5, duration_s=900.0,
                   setpoint_moves=MOVES, noise_sd=0.06)
    return replace(base, **more)


def with_a_step(options: Options = HELD) -> tuple[Loop, Study]:
    """A loop with a step disturbance, and its study."""
    loop = simulate(setting(duration_s=600.0, effects=(("step-disturbance", {"time_s": 350.0, "size": 1.2}),)),
                    seed=21).loop
    return loop, identify(loop, options=options)


@pytest.fixture(scope="module")
def stepped() -> tuple[Loop, Study]:
    return with_a_step(PLAIN)


@pytest.fixture(scope="module")
def searched(stepped: tuple[Loop, Study]) -> Study:
    """The study of the loop with a step after a search for a few effects."""
    with asked_only(*FEW):
        return diagnose(*stepped)


def step_is_named(after: Study, asked: int) -> None:
    """The step is named among so many effects, and each of the others has its reason."""
    assert after.missing == ("step-disturbance",) and after.candidates[0].variant == "output"
    # Every effect that is not named has its reason, and gains less beyond noise than the one that is.
    named, *others = [c for c in after.candidates if c.delta_bic is not None]
    assert named.accepted and len(others) > asked - 2 and all(c.rejected_because for c in others)
    assert max(c.gain_beyond_noise or 0.0 for c in others) < 0.5 * (named.gain_beyond_noise or 0.0)


def test_a_hidden_step_is_named_and_every_other_effect_has_its_reason(searched: Study) -> None:
    """Among a few effects; benchmarks/long names it among all."""
    step_is_named(searched, len(FEW))


def test_an_effect_whose_fit_breaks_down_is_reported_and_the_others_go_on(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stepped: tuple[Loop, Study]) -> None:
    (tmp_path / "broken.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from stictionid.effects.ramp_disturbance import EFFECT as ramp\n"
        "def _columns(theta, context):\n"
        "    raise np.linalg.LinAlgError('SVD did not converge')\n"
        "EFFECT = replace(ramp, name='broken', columns=_columns, confused_with=())\n")
    monkeypatch.setattr(effect_room, "__path__", [*effect_room.__path__, str(tmp_path)])
    with asked_only("broken", "step-disturbance", "extra-lag"):
        after = diagnose(*stepped)
    assert after.missing == ("step-disturbance",)
    broken = [c for c in after.candidates if c.effect == "broken"]
    assert broken and all(c.delta_bic is None and "did not converge" in c.statement for c in broken)


def test_a_further_tag_is_seen_in_innovations_unless_it_is_in_the_model() -> None:
    loop = simulate(setting(duration_s=1500.0), seed=5).loop
    rng = np.random.default_rng(9)
    tag = np.cumsum(rng.normal(size=loop.samples) * (rng.random(loop.samples) < 0.02))
    loop = replace(loop, extras={"feed": tag})
    known, unknown = (Model(loop, Spec(effects=names), s_max=10.0, period_s=60.0)
                      for names in (("measured-disturbance:feed",), ()))
    good = np.arange(loop.samples) > 60
    # Noise that walks: errors in differences, and of the tag its moves.
    walk, moves = np.array([1.0, -1.0]), np.diff(tag, prepend=tag[0])
    size = np.sqrt(np.expm1((50.0 + np.log(loop.samples)) / loop.samples)) / moves.std()
    seen = {known: 0, unknown: 0}
    for e in rng.normal(size=(25, loop.samples)):
        assert loop.position is not None
        seen[known] += passes_tests(known, walk, 0, loop.position, e, good)
        seen[unknown] += passes_tests(unknown, walk, 0, loop.position, e + 2.0 * size * np.roll(moves, 2), good)
    assert seen[known] >= 23 and seen[unknown] <= 2


def test_prewhitening_of_the_process_is_kept_and_extended_by_a_noise_model() -> None:
    loop = simulate(setting(effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.05}),), noise_sd=0.0),
                    seed=5).loop
    spec = Spec(taps=(0.5, 0.1))
    model = Model(loop, spec, s_max=8.0, period_s=80.0)
    values = np.array([4.0, 2.5, 0.15, 6.0, 3.0])
    assert own_taps(spec) == (0.5, 0.1) and own_taps(Spec(effects=("coloured-noise",), taps=(0.5,))) == ()
    first = complete_quickly(model, values)
    assert first.own == (0.5, 0.1) and first.taps.size > 0
    expected = np.convolve([1.0, 0.5, 0.1], np.concatenate([[1.0], first.taps]))[1:]
    np.testing.assert_allclose(first.spec.taps, expected)
    done = complete_model(model, values, None, np.random.default_rng(0))
    assert done.model.spec.taps[:1] != (0.5,) and len(done.model.spec.taps) == 2 + done.taps.size
    assert done.innovation_sd == pytest.approx(0.05, rel=0.08)


def test_a_resonance_is_found_in_a_spectrum_made_of_it() -> None:
    rng = np.random.default_rng(3)
    r, w0 = np.exp(-1.0 / (4.0 * 20.0)), 2.0 * np.pi / 20.0
    x, white = np.zeros(3000), rng.standard_normal(3000)
    for k in range(2, x.size):
        x[k] = 2.0 * r * np.cos(w0) * x[k - 1] - r * r * x[k - 2] + white[k]
    x = x / x.std() + 0.5 * rng.standard_normal(x.size)
    found = resonance(x, np.ones(x.size, bool), rng)
    assert found is not None and found.period == pytest.approx(20.0, rel=0.03)
    assert found.coherence == pytest.approx(4.0, rel=0.4) and found.share == pytest.approx(0.8, abs=0.08)
    w = np.linspace(0.01, np.pi, 5)
    flat = shape(w, np.array([0.3]), np.array([5.0]), np.array([0.0]))
    assert np.allclose(flat, 1.0)


def test_refusals_leave_the_study_as_it_is(tmp_path: Path, stepped: tuple[Loop, Study]) -> None:
    loop, study = stepped
    for name in ("step-disturbence", "measured-disturbance", "measured-disturbance:FEED", "extra-lag@load"):
        with pytest.raises(UsageError) as refusal:
            add(loop, study, name)
        assert refusal.value.hint
    dead = Loop(output=np.full(300, 40.0), process_value=np.random.default_rng(0).standard_normal(300))
    with pytest.raises(DataError):
        diagnose(dead, identify(dead))

    def run(*arguments: object):
        return commands.run(*arguments, cwd=tmp_path)

    assert run("simulate", "--S", 4, "--J", 2, "--noise", 0.05, "--scan", 1, "-o", "a.csv").returncode == 0
    assert run("identify", "a.csv", "--base-only", "-o", "s.json").returncode == 0
    text = (tmp_path / "s.json").read_text()
    newer = json.loads(text) | {"schema": "stictionid.study/99"}
    (tmp_path / "newer.json").write_text(json.dumps(newer))
    with open(tmp_path / "a.csv", "a") as file:
        file.write("\n")
    # A name that is no effect is refused before the file is looked at, which has changed.
    for arguments, code in ((("add", "extra-lug", "s.json"), 2), (("add", "extra-lag", "s.json"), 3),
                            (("diagnose", "s.json"), 3),
                            (("diagnose", "newer.json"), 3), (("add", "extra-lag", "gone.json"), 2),
                            (("diagnose", "a.csv", "s.json"), 3)):
        refused = run(*arguments)
        assert refused.returncode == code and "Traceback" not in refused.stderr and refused.stdout == ""
    assert "a.csv: not a study" in refused.stderr and "give the study first" in refused.stderr
    assert (tmp_path / "s.json").read_text() == text


def test_the_gain_may_change_by_most_of_itself_within_what_most_of_the_record_reaches() -> None:
    y = np.concatenate([np.linspace(45.0, 55.0, 990), np.full(10, 90.0)])
    context = Context(y, y, np.full(y.size, 50.0), 1.0, 50.0)
    (limits,) = get_effect("gain-nonlinearity").parameters_for(context)
    assert limits.high == pytest.approx(0.8 / np.quantile(np.abs(y - 50.0), 0.9))
    assert limits.high > 0.8 / 5.0 and limits.low == -limits.high


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, stepped: tuple[Loop, Study], searched: Study) -> Path:
    """A folder with the loop that has a step, and its study before and after a search."""
    place = tmp_path_factory.mktemp("stepped")
    write_loop(stepped[0], place / "a.csv")
    written = read_loop(place / "a.csv")
    for name, study in (("base", stepped[1]), ("searched", searched)):
        record = replace(study, data=data_record(written, written))
        (place / f"{name}.json").write_text(to_json(record), encoding="utf-8")
    return place


def diagnosed(folder: Path, study: str, *options: object) -> dict[str, Any]:
    """The study that `diagnose` prints."""
    done = commands.run("diagnose", study, "--json", "-q", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_a_bootstrap_gives_the_named_effect_its_p_value(folder: Path, searched: Study) -> None:
    """No replicate of nine without the step gains as much, so p is one in ten, the least that nine can show.

    The search goes on from the tree of models that the study holds.
    """
    with asked_only(*FEW):
        study = diagnosed(folder, "searched.json", "--bootstrap", 9)
    assert study["missing"] == ["step-disturbance"] and study["candidates"][0]["accepted"]
    assert "bootstrap" not in searched.candidates[0].statement
    assert study["candidates"][0]["statement"].endswith("; bootstrap p = 0.1")


def test_a_gain_that_replicates_without_the_effect_reach_is_chance() -> None:
    loop = recorded(0.2 * np.random.default_rng(4).standard_normal(600))
    search = Search(loop, Policy(), 0, 1, lambda words, share: None)
    root = search.root(as_it_stands(model_on(loop, Spec()), scored(loop).done.values))
    assert p_of(search, root, "step-disturbance@output", 9, lambda words, share: None) > 0.1
