"""Every effect of the catalogue on the command line: hidden by `simulate`, fitted by `identify --with` and `add`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from loops_with_effects import MOVES, NOISE, PLANTS, SAMPLES, SMALL
from scipy.signal import lfilter
from typer.testing import CliRunner

from stictionid.cli.app import app
from stictionid.effects import catalogue, get
from stictionid.errors import StictionidError
from stictionid.reports.pages.atlas import atlas_picture, atlas_words

PLANT, CONTROLLER = PLANTS[1]
ROOT = Path(__file__).parent.parent


def command(*words: object):
    """One command in this process: (exit code, standard output, the refusal or None)."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit | StictionidError):
        raise done.exception
    return done.exit_code, done.stdout, done.exception if isinstance(done.exception, StictionidError) else None


# What `identify --with` takes in here: a valve effect. Tags, variants and noises are in benchmarks/long.
TAKEN_IN = ("asymmetric-stiction",)


def hidden(name: str, folder: Path) -> tuple[Path, dict]:
    """The export of a small loop with an effect that `simulate` has hidden, and its truth."""
    spelt = f"{name}:" + ",".join(f"{parameter}={value}" for parameter, value in SMALL[name][2].items())
    kind = ["--integrating"] if "integrator" in get(name).needs else []
    moves = [word for time, size in (SMALL[name][1] or MOVES) for word in ("--setpoint", f"{time}:{size}")]
    export = folder / "loop.csv"
    code, _, refusal = command(
        "simulate", "--gain", PLANT.gain, "--time-constant", PLANT.time_constant_s, "--dead-time", PLANT.dead_time_s,
        "--kc", CONTROLLER.gain, "--ti", CONTROLLER.integral_time_s, "--scan", 1, "--S", 4, "--J", 2.5, "--duration",
        SAMPLES, "--noise", 0.0 if name == "coloured-noise" else NOISE, "--seed", 21, *kind, *moves, "--effect", spelt,
        "-o", export, "-q")
    assert (code, refusal) == (0, None)
    truth = json.loads((folder / "loop.truth.json").read_text())
    assert [effect["name"] for effect in truth["effects"]] == [name]
    return export, truth


@pytest.mark.parametrize("name", sorted(set(SMALL) - set(TAKEN_IN)))
def test_an_effect_is_hidden_as_it_was_asked_for(name: str, tmp_path: Path) -> None:
    _, truth = hidden(name, tmp_path)
    given = truth["effects"][0]["parameters"]
    assert all(given[parameter] == value for parameter, value in SMALL[name][2].items())


@pytest.mark.parametrize("name", TAKEN_IN)
def test_an_effect_is_hidden_added_and_not_added_twice(name: str, tmp_path: Path) -> None:
    export, truth = hidden(name, tmp_path)
    study = tmp_path / "study.json"
    tag = ["--extra", "D1"] if name == "measured-disturbance" else []
    asked = f"{name}:D1" if tag else name
    code, printed, refusal = command("identify", export, *tag, "--with", asked, "-o", study, "--json", "-q",
                                     "--no-intervals", "--between", "hold")
    assert (code, refusal) == (0, None)
    steps = json.loads(printed)["steps"]
    # A noise model is a step of its own; what moves the free run is in the base model.
    assert (steps[-1] if get(name).noise else steps[0])["model"]["effects"] == [asked]
    assert steps[-1]["error"]["rmse_one_step"] < 1.05 * noise_of(truth, name)
    before = study.read_bytes()
    code, _, refusal = command("add", asked, study, "-q")
    assert code != 0 and refusal is not None and f"has {asked} already" in str(refusal)
    assert study.read_bytes() == before


def noise_of(truth: dict, name: str) -> float:
    """What can't be predicted of the next sample, standard deviation: of a noise effect as an autoregression of a far
    longer draw of it predicts."""
    if get(name).noise is None:
        return truth["noise_sd"]
    rng = np.random.default_rng(0)
    drawn, load, _ = get(name).disturb(truth["effects"][0]["parameters"], np.arange(50_000.0), rng)
    # What enters before the process comes through its lag; no later sample depends on its dead time.
    root = np.exp(-1.0 / PLANT.time_constant_s)
    passed = lfilter([PLANT.gain * (1.0 - root)], [1.0, -root], load)
    x = drawn + passed + truth["noise_sd"] * rng.standard_normal(drawn.size)
    lags = np.lib.stride_tricks.sliding_window_view(x, 41)
    past, now = lags[:, :-1], lags[:, -1]
    return float(np.std(now - past @ np.linalg.lstsq(past, now, rcond=None)[0]))


def test_the_atlas_holds_every_effect_with_its_present_words() -> None:
    text = (ROOT / "docs" / "atlas.md").read_text(encoding="utf-8")
    for name in catalogue():
        assert f"## {name}\n" in text and (ROOT / "docs" / "atlas" / f"{name}.svg").is_file()
        assert all(words in text for words in atlas_words(name)), f"{name}: run python docs/make_atlas.py"


def test_the_picture_of_an_effect_shows_its_trace() -> None:
    drawn = atlas_picture("sinusoidal-disturbance")
    residual = drawn.panels[-1].lines[0].y
    assert np.nanstd(residual) > 5 * 0.05 and "residual of" in drawn.alt


def test_a_picture_of_an_effect_is_drawn_or_refused_in_one_sentence(tmp_path: Path) -> None:
    assert command("effects", "extra-lag", "--picture", tmp_path / "lag.svg")[0] == 0
    assert (tmp_path / "lag.svg").stat().st_size > 5000
    for words in (("effects", "--picture", "lag.svg"), ("effects", "extra-lag", "--picture", "lag.pdf")):
        refusal = command(*words)[2]
        assert refusal is not None and "effects extra-lag --picture lag.svg" in refusal.hint
