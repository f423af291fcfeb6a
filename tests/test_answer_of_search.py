"""An answer of the search: its candidates, the intervals of its equivalents, its structure and its base.

Two lags in place of a process that rings are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import MOVES, SAMPLES, SETTINGS, Values, model_on, recorded, scored, search_among, true_values
from scipy.signal import lfilter
from study_factory import good

from stictionid.fit.noise.completion import along_slips
from stictionid.fit.public_values import rows_in
from stictionid.model.closed_loop import simulate
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.paths.settle import settle_path
from stictionid.record.loop import Loop
from stictionid.record.tree import Gate
from stictionid.selection.decide import Decision, candidates, decide_answer, reach_of
from stictionid.selection.entry import ADD, ROOT, SWAP, Entry, failed_entry
from stictionid.selection.looks import Packed, Task
from stictionid.selection.node import key, other_process
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored

POLICY = Policy()
STOP, STEP, LAG = "travel-limit", "step-disturbance@output", "extra-lag"
SHORT = 300
WHITE = 0.2 * np.random.default_rng(4).standard_normal(SAMPLES)
SLOW = np.asarray(lfilter([1.0], [1.0, -0.97], WHITE[:SHORT]))
AT = {f"{STEP}:time_s": 160.0}


def entry(loop: Loop, *names: str, values: Values | None = None, parent: Entry | None = None, failed: str = "",
          spec: Spec | None = None) -> Entry:
    """A node at the true values, a few changed; `failed` is a gate that it does not pass."""
    spec = spec or Spec(effects=names)
    gates = (Gate(failed, False, "no"),) if failed else ()
    return Entry(spec, scored(loop, spec, values), None if parent is None else key(parent.spec),
                 ROOT if parent is None else ADD if names else SWAP, names[-1] if names else spec.process, gates=gates)


def test_every_effect_asked_is_a_candidate_the_named_one_first() -> None:
    """The lag is in the model of the study, and the stop could not be fitted."""
    loop = recorded(np.asarray(lfilter([1.0], [1.0, -0.97], WHITE)) + 6.0 * (np.arange(SAMPLES) >= 640))
    base = entry(loop)
    step = entry(loop, STEP, values={f"{STEP}:time_s": 640.0}, parent=base)
    lag = entry(loop, LAG, parent=base, failed="gain")
    stop = Spec(effects=(STOP,))
    broken = failed_entry(base, Task(stop, STOP), Packed(stop, STOP, failed="its refit did not converge"))
    study = good().study
    study = replace(study, steps=(replace(study.steps[0], effects=(LAG,)),))
    rows = candidates(search_among(base, lag, broken, step), Decision(step, "", (), ""), (STEP,), study, {})
    assert [(row.effect, row.accepted) for row in rows if row.effect != "coloured-noise"] == [
        ("step-disturbance", True), (LAG, True), (STOP, False)]
    assert rows[0].gain_beyond_noise == pytest.approx(step.scored.done.gain_over(base.scored.done))
    last = rows[-1]
    assert (last.rmse, last.rejected_because) == (None, "could not be fitted") and "did not converge" in last.statement


def test_only_the_best_equivalents_give_intervals() -> None:
    loop = recorded(WHITE[:SHORT])
    one, other = entry(loop), entry(loop, LAG, values={"S": 7.5})
    (low, high), point = reach_of(search_among(one, other, policy=replace(POLICY, finalists=1)), (one, other))["S"]
    assert low < 3.6 < high < 7.5 and point == (7.5, 7.5)
    assert reach_of(search_among(one), ()) == {}


@pytest.mark.parametrize(("time_constant_s", "long"), [(200.0, True), (17.0, False)])
def test_beside_a_lag_of_many_periods_an_integrator_is_fitted(time_constant_s: float, long: bool) -> None:
    loop, spec = recorded(SLOW), other_process(Spec())
    lagging = entry(loop, LAG, values={"time_constant_s": time_constant_s})
    integrator = entry(loop, spec=spec, parent=lagging)
    assert spec.process == INTEGRATOR
    assert search_among(lagging, integrator).fit_integrator(lagging) is (integrator if long else None)


@pytest.mark.parametrize("needed", [True])
def test_a_lag_that_the_best_node_no_longer_needs_is_dropped(needed: bool) -> None:
    """The budget is spent, so that nothing else is fitted. A lag that is not needed is in benchmarks/long."""
    values = {f"{LAG}:second_time_constant_s": 8.0 if needed else 0.02, **AT}
    both = Spec(effects=(LAG, STEP))
    loop = recorded(0.1 * SLOW + 6.0 * (np.arange(SHORT) >= 160), both, values)
    base = entry(loop, values={})
    best = entry(loop, *both.effects, values=values, parent=base)
    search = search_among(base, best, only=frozenset())
    search.budget.spent = 3 * POLICY.budget
    search.expand(best)
    assert search.memo[key(Spec(effects=(STEP,)))].settled is not needed


def test_a_valve_that_never_moves_identifies_no_number_of_its_effects() -> None:
    loop = recorded(WHITE[:SHORT])
    done = scored(loop, Spec(effects=(STOP,)), {"S": 60.0, "J": 60.0}).done
    assert not np.isfinite(done.model.costs_of(done.values[:, None])).any()
    rows = rows_in(STOP, done.model, done.values, done.evaluated)
    assert rows and not any(row.identifiable for row in rows)


def test_an_answer_along_a_path_that_was_never_asked_is_asked_for_what_it_lacks() -> None:
    """A decision that goes further names the step along the slips of a winner, and any other one names nothing."""
    setting = replace(SETTINGS[FIRST_ORDER], duration_s=float(SAMPLES), setpoint_moves=MOVES, scatter=0.2, noise_sd=0.1)
    step = np.where(np.arange(SAMPLES) >= 640, 1.0, 0.0)
    model = model_on(replace(simulate(setting, seed=2, disturbance=step).loop, position=None), Spec())
    answer = Entry(Spec(), Scored(along_slips(settle_path(model, model.vector(true_values())))))
    assert answer.scored.by_pv
    for further, names in ((False, ()), (True, ("step-disturbance@output",))):
        found = decide_answer(search_among(answer, only=frozenset({"step-disturbance"})), answer, spans=False,
                              further=further)
        assert found.winner.spec.effects == names
    values = found.winner.scored.done.evaluated.values
    assert values["S"] == pytest.approx(3.6, rel=0.03)
    assert values["step-disturbance@output:time_s"] == pytest.approx(640.0, abs=1.0)
