"""Other tags of an export as sources of a disturbance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loops_with_effects import small

from stictionid.batch.summary.groups import grouped, groups_said
from stictionid.effects import get
from stictionid.effects.contract import Context
from stictionid.fit.noise.completion import complete_quickly
from stictionid.historian.bytes.options import ReadOptions
from stictionid.historian.reading import read
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.selection.gates import by_choice, margin_of
from stictionid.selection.policy import Policy

MEASURED = "measured-disturbance"
ROWS = 1200
WALK = np.cumsum(np.random.default_rng(3).standard_normal(ROWS + 40))


def seen(residual: np.ndarray, tag: np.ndarray) -> Context:
    """The context of a look at a residual with a tag."""
    return Context(np.zeros(ROWS), np.zeros(ROWS), None, 1.0, 60.0, residual=residual, extras={"T": tag})


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(ROWS)


def test_every_other_tag_is_read_but_not_those_of_the_loop_itself(tmp_path: Path) -> None:
    header = "Timestamp,FIC1.SP,FIC1.PV,FIC1.OP,FIC1.ZT,FIC2.PV,FIC2.OP,FIC2.MODE,TI7,Shift,used\n"
    rows = [f"2026-02-25T06:{k // 60:02d}:{k % 60:02d},50,{50 + k % 7},{40 + k % 5},{k % 3},{k % 11},{k % 13},AUTO,"
            f"{k % 17},night,1\n" for k in range(300)]
    file = tmp_path / "unit.csv"
    file.write_text(header + "".join(rows))
    loop = read(str(file), options=ReadOptions(loop="FIC1", extra=("*",))).loop
    assert set(loop.extras) == {"FIC2.PV", "FIC2.OP", "TI7"} and loop.position is not None
    assert loop.extras["TI7"][20] == 3.0
    assert not read(str(file), options=ReadOptions(loop="FIC1")).loop.extras


def test_the_residual_shows_its_source_and_the_time_by_which_that_is_ahead() -> None:
    effect = get(MEASURED)
    assert effect.shown and effect.guess and effect.picked_from
    driven = noise(1) + 2.0 * WALK[5:-35]
    context = seen(driven, WALK[35:-5])
    assert effect.shown(context) > 10 * 2 * np.log(effect.picked_from(context))
    lag, dead = effect.guess(context)[-4]
    assert lag <= 2.0 and dead == pytest.approx(30.0, abs=1.0)
    beyond = [effect.shown(c) > 2 * np.log(20 * effect.picked_from(c))
              for c in (seen(noise(10 + i), np.cumsum(noise(50 + i))) for i in range(20))]
    assert sum(beyond) <= 1


def test_the_margin_grows_with_the_number_of_tags_and_only_for_tags() -> None:
    _, loop = small()
    margins = []
    for count in (1, 20):
        tags = {f"T{i}": noise(i)[:loop.samples] for i in range(count)}
        model = Model(replace(loop, extras=tags), Spec(), s_max=10.0, period_s=60.0)
        done = complete_quickly(model, model.values(np.full((1, model.space.size), 0.5))[:, 0])
        margins.append(margin_of(f"{MEASURED}:T0", Policy(), done))
        assert by_choice("step-disturbance@load", done) == 0.0
    assert margins[1] - margins[0] == pytest.approx(2 * np.log(20)) and margins[0] > Policy().margin


def test_a_group_says_whose_tags_drive_its_loops() -> None:
    rhythm = {"period_s": 60.0, "cycles": 40.0, "harmonics": 0.2, "phase": 0.4, "middle_s": 0.0}
    rows = [{"loop": "FIC101", "verdict": "stiction", "rhythm": rhythm},
            *({"loop": name, "verdict": "no stiction", "rhythm": {**rhythm, "harmonics": 0.01}, "driver": tag}
              for name, tag in (("TIC2", "FIC101.PV"), ("LIC3", "FIC1011.PV"), ("PIC4", None)))]
    (said,) = groups_said(grouped(rows))
    assert "its tags drive TIC2, which confirms it" in said and "other tags drive LIC3 by FIC1011.PV" in said
    assert "PIC4" not in said
