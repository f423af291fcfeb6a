"""None of these: the shape of what a model misses, in numbers and in one sentence, and no verdict of adequacy."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import study_factory

from stictionid.effects import leaving
from stictionid.fit.noise.completion import Refit, complete_quickly
from stictionid.fit.noise.unexplained import SHARE, judged_by, missing_words, unexplained_shape
from stictionid.fit.points.moves import behind_valve
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.study import study_from_json, to_json
from stictionid.reports.facts import facts

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

from plants.beyond import drawn_beyond
from plants.score import loop_of


def left_by(effect: str, seed: int) -> Refit:
    """First order with the true valve, its process polished, on an independent loop, completed with noise."""
    plant = drawn_beyond(effect, seed)
    loop, truth = loop_of(plant), plant.truth
    model = Model(loop, Spec(effects=("re-sticking",) if truth["rests"] else ()), s_max=float(np.ptp(loop.output)),
                  period_s=60.0)
    process = truth["process"]
    at = model.vector({"S": truth["S"], "J": truth["J"], "initial_residual_force": 0.0,
                       "time_constant_s": 1.3 * process["time_constant_s"], "dead_time_s": process["dead_time_s"] + 3.0,
                       **({"re-sticking:restick_speed": 1e3} if truth["rests"] else {})})
    found = behind_valve(model, model.cube(at[:, None]), slice(3, 5), turns=40, settle=1e-7)
    return complete_quickly(model, model.values(found.points[:1])[:, 0])


@pytest.fixture(scope="module")
def wrong_way() -> Refit:
    """A third order with two zeros, which is in no catalogue."""
    return left_by("third-order-two-zeros", 1001)


def test_a_process_outside_the_catalogue_is_answered_with_its_shape(wrong_way: Refit) -> None:
    shape = unexplained_shape(wrong_way)
    assert shape is not None and shape.named == "valve moves" and shape.suggests[0] == "inverse-response"
    assert "the residual answers valve moves with a dip of" in shape.statement
    assert "inverse-response would do that" in shape.statement and "tried" not in shape.statement
    again = unexplained_shape(wrong_way, tried=leaving("dip"))
    assert again is not None and again.statement.endswith("but was tried and does not help enough")
    strongest = max(shape.answers, key=lambda a: a.share)
    assert strongest.to == shape.named and strongest.share >= SHARE
    # The response is far beyond its bounds somewhere within the process's time, and settles.
    step = np.array([shape.step.value, shape.step.low, shape.step.high]) / wrong_way.evaluated.gain
    assert step[2].min() < -0.02 and abs(step[0, -1]) < 0.02
    assert all(len(c.at) == len(c.value) == len(c.low) == len(c.high) >= 8
               for c in (shape.impulse, shape.opening, shape.closing, shape.by_value, shape.by_time))
    assert sum(share for _, _, share, _ in shape.spectrum) == pytest.approx(1.0)


def test_a_right_model_has_no_shape() -> None:
    assert all(unexplained_shape(left_by("clean", seed)) is None for seed in (1001, 1003))


def test_such_a_model_is_not_adequate_and_the_study_keeps_the_shape(wrong_way: Refit) -> None:
    shape = unexplained_shape(wrong_way)
    assert shape is not None
    adequate, why = judged_by(shape, True, "nothing is left")
    assert not adequate and shape.statement in why and judged_by(None, True, "fine") == (True, "fine")
    assert judged_by(shape, False, "far from the noise") == (False, "far from the noise")
    study = replace(study_factory.good(240).study, unexplained=shape, missing_reason=missing_words(shape),
                    adequate=adequate, adequate_reason=why)
    assert study_from_json(to_json(study)) == study
    ladder = next(s for s in facts(study).sections if s.key == "ladder")
    assert any("one of the models tried explains this record" in line for line in ladder.text)


def test_the_shape_names_what_the_residual_answers() -> None:
    shape = unexplained_shape(left_by("direction-dependent-lag", 1001))
    assert shape is not None and shape.named == "the direction of valve moves"
    assert set(shape.suggests[:2]) < set(leaving("direction")) and " would do that" in shape.statement
    closing, opening = np.array(shape.closing.value), np.array(shape.opening.value)
    assert np.abs(closing - opening).max() > 2.0 * np.abs(shape.step.value).max()
