"""Hand-made studies and curves for report tests: a good, a doubtful, an abstained, a hostile one, of any length.

The records are sums of exact shapes rather than simulations, so that golden files do not depend on the simulator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from loops_with_effects import SMALL, small

from stictionid.model.closed_loop import OPERATING_POINT
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.record.evidence import Evidence
from stictionid.record.loop import Finding, Loop
from stictionid.record.study import (
    Candidate,
    CostMap,
    CreatedBy,
    Cycle,
    DataRecord,
    ErrorSummary,
    Estimate,
    LawResult,
    ParameterValue,
    PositionEstimate,
    Range,
    Restarts,
    Step,
    Study,
    Verdict,
)
from stictionid.record.swing import Share, Swing
from stictionid.record.tree import Edge, Equivalent, Gate, TreeNode
from stictionid.reports.pictures.curves import Case, curves

MADE_BY = CreatedBy("0.1.0", 7, "3.11.0", "2.4.6", "0.68.1")
HOSTILE = ('<script>alert("x")</script>\n| a | `b` **c** [d](javascript:e) \u202egnp.exe\u202c \x1b[31mred\x07 '
           "'; DROP -- =1+1 @SUM &amp; ]]> <!-- \x00 \ud800 " + "long" * 1300)


@dataclass(frozen=True)
class StubCurves:
    """Same fields as the model's curves."""

    time_s: np.ndarray
    setpoint: np.ndarray | None
    output: np.ndarray
    process_value: np.ndarray
    model: np.ndarray
    residual: np.ndarray
    position: np.ndarray


def _triangle(t: np.ndarray, period: float) -> np.ndarray:
    phase = (t / period) % 1.0
    return 4.0 * np.abs(phase - 0.5) - 1.0


def _valve(u: np.ndarray, S: float, J: float) -> np.ndarray:
    """Position of a sticking valve, one sample after the other (He's law is enough for a picture)."""
    slide, v = (S - J) / 2, np.empty_like(u)
    place, direction, stuck, before = u[0], 0.0, True, u[0]
    for k, command in enumerate(u):
        move = np.sign(command - before)
        if move != 0 and move != direction:
            stuck, direction = True, move
        if stuck and abs(command - place) > (S + J) / 2:
            stuck = False
        if not stuck:
            place = command - np.sign(command - place) * slide
        v[k], before = place, command
    return v


def record(samples: int = 600, *, period: float = 60.0, noise: float = 0.05, S: float = 5.0, J: float = 2.0,
           position: bool = False, name: str = "FIC101") -> tuple[Loop, StubCurves]:
    """A made-up oscillating loop and the curves of a model that fits it but for a stretch near the end."""
    t = np.arange(samples, dtype=float)
    rng = np.random.default_rng(3)
    u = 50.0 + (S + 1.5) / 1.6 * _triangle(t, period)
    v = _valve(u, S, J)
    clean = 50.0 + np.convolve(v - 50.0, np.exp(-np.arange(40) / 8.0) / 8.0)[:samples]
    y = clean + noise * rng.standard_normal(samples)
    at = int(0.8 * samples)
    y[at:at + samples // 12] += 6 * noise
    used = np.ones(samples, bool)
    used[: samples // 40] = False
    zt = v + 0.02 * rng.standard_normal(samples) if position else None
    loop = Loop(output=u, process_value=y, setpoint=np.where(t < samples / 2, 50.0, 50.5), position=zt, used=used,
                units={"output": "%", "process_value": "m³/h", "setpoint": "m³/h"}, name=name)
    model = clean.copy()
    model[: samples // 40] = np.nan
    return loop, StubCurves(t, loop.setpoint, u, y, model, y - model, v)


def _range(period: float, count: int) -> Range:
    cycles = tuple(Cycle(period * k + 3.0, period, 8.125) for k in range(count))
    return Range(True, period, period, 8.125, cycles, f"{count} whole cycles, lengths within 1 % of the mean",
                 reversals=2 * count)


def _data(name: str, rows: int, *, position: bool = False) -> DataRecord:
    columns = {"time": "Time", "setpoint": f"{name}.SP", "process_value": f"{name}.PV", "output": f"{name}.OP"}
    columns |= {"position": f"{name}.ZT"} if position else {}
    return DataRecord("plant/fic101.csv", "5f2c" * 16, columns, {"process_value": "m³/h", "output": "%",
                      "setpoint": "m³/h"}, rows, rows - rows // 40, 1.0, "2024-03-01T06:00:00", "2024-03-01T06:09:59",
                      (Finding("filled", "info", "3 samples of PV were missing and filled", {"rows": 3}),), name=name,
                      options={"decimal": ","})


def _step(added: str | None, rmse: float, effects: tuple[str, ...], findings: tuple[Finding, ...] = ()) -> Step:
    parameters = [ParameterValue(None, "S", 5.012, "%", (4.961, 5.058), meaning="stickband plus deadband"),
                  ParameterValue(None, "J", 2.031, "%", (1.88, 2.19), meaning="slip jump"),
                  ParameterValue(None, "gain", 0.998, "m³/h per %"),
                  ParameterValue(None, "dead_time_s", 0.0, "s", at_bound=True)]
    if added:
        parameters.append(ParameterValue(added, "second_time_constant_s", 2.11, "s", (1.7, 2.6)))
    return Step(added, effects, tuple(parameters), ErrorSummary(rmse, rmse * 1.04, 0.0504, 0.0511, 0.05, 96.2, -3451.0),
                Restarts(8, 7), findings)


def _map(S: float, J: float, size: int = 25) -> CostMap:
    s, j = np.linspace(0.2, 1.6 * S, size), np.linspace(0.0, 1.5 * S, size)
    rmse = tuple(tuple(float(0.05 + 0.3 * abs(a - S) / S + 0.08 * abs(b - J) / S) if b <= 2 * a else None for b in j)
                 for a in s)
    return CostMap(tuple(map(float, s)), tuple(map(float, j)), rmse, ((S * 1.01, J), (S, J * 0.96), (S * 1.3, J * 0.5)))


def good(samples: int = 600) -> Case:
    """Clear stiction with a measured position, two steps, candidates, laws and a cost map."""
    loop, curves = record(samples, position=True)
    estimate = Estimate(5.012, 2.031, "%", (4.961, 5.058), (1.88, 2.19), 0.9, "chen", 0.998, (8.02,), 0.0, False,
                        -0.12, PositionEstimate(4.98, 2.05, 0.02, 1.0, 0.0))
    failing = Finding("residual-in-time", "warning", "the residual is larger from 480 to 530 s",
                      {}, ("step-disturbance",), "running RMS", stretches=((480.0, 530.0),))
    candidates = (Candidate("extra-lag", True, 0.0521, 0.0542, 0.0511, 38.0, 21.0, -153.2, ("coloured-noise",), None,
                            (), "a second lag of 2.1 s lowers the error by 38 %"),
                  Candidate("slew-limit", False, 0.083, 0.087, 0.0641, 1.0, 0.4, 3.1, (), "slower than 0.8 %/s"))
    study = Study(MADE_BY, _data("FIC101", samples, position=True), _range(60.0, samples // 60),
                  Verdict("stiction", "with friction the held-out error falls from 1.31 to 0.054", 0.99,
                          Evidence(further={"error_without": 1.31, "error_with": 0.054})),
                  estimate, (_step(None, 0.084, ()), _step("extra-lag", 0.0521, ("extra-lag",), (failing,))),
                  (LawResult("chen", 5.01, 2.03, 0.054, 0.0521), LawResult("he", 4.71, 2.33, 0.091, 0.088)),
                  candidates, ("extra-lag",), True, "nothing is left above the noise", _map(5.012, 2.031),
                  "stictionid identify plant/fic101.csv --seed 7 -o study.json")
    return Case(study, loop, (curves, curves))


def node(number: int, parent: int | None, op: str, what: str, rmse: float | None, bic: float | None, status: str,
         reason: str = "", *, structure: str = "chen, first-order, hold") -> TreeNode:
    """One model of a made-up search; `reason` is that of the gate that it failed."""
    gates = (Gate("noise", True, "whitened"), *([Gate("held-out", False, reason)] if reason else []))
    return TreeNode(number, parent, Edge(op, what), () if op == "root" else (what,), structure, "white",
                    {"S": 5.0, "J": 2.0}, rmse, rmse, bic, status, gates)


def searched(samples: int = 600) -> Case:
    """The good study with the tree of a search: an answer of two effects, dead ends, and a model alike."""
    case = good(samples)
    base = "chen, first-order, hold"
    tree = (node(0, None, "root", base, 1.168, -100.0, "named"),
            node(1, 0, "add", "travel-limit", 0.0604, -2840.0, "named"),
            node(2, 1, "add", "extra-lag", 0.0504, -2990.0, "named"),
            node(3, 1, "add", "stiction-drift", 0.0602, -2838.0, "rejected", "the gain of 2 BIC is below the margin"),
            node(4, 0, "add", "extra-lag", 0.85, -400.0, "expanded", "nothing beside it reaches the noise"),
            node(5, 4, "add", "asymmetric-stiction", 0.83, -420.0, "rejected",
                 "the residual answers past valve positions more than before: correlation 0.31 at 4 samples"),
            node(6, 4, "add", "slip-overshoot", 0.058, -2980.0, "equivalent"),
            node(7, 0, "swap", "integrator", None, None, "failed", "runs away from y",
                 structure="chen, integrator, hold"),
            *(node(8 + k, 0, "add", f"effect-{k}", 1.16 - 0.001 * k, -100.0 - 0.05 * k, "looked") for k in range(9)))
    alike = Equivalent(6, ("extra-lag", "slip-overshoot"), 4.4, 2.3, -2980.0, "a bump in MAN of 5 %")
    candidates = tuple(replace(c, gain_beyond_noise=150.0 if c.accepted else 0.5,
                               rejected_because="" if c.accepted else "the gain of 0.5 BIC is below the margin")
                       for c in case.study.candidates)
    swing = Swing((Share("valve", 0.704), Share("extra-lag", 0.213), Share("start", 0.001), Share("noise", 0.082)),
                  (Share("valve", 0.624), Share("setpoint", 0.004), Share("extra-lag", 0.305), Share("noise", 0.067)),
                  1.31, 0.803)
    study = replace(case.study, swing=swing, tree=tree, evaluations=12345, unasked=("gain-nonlinearity",),
                    equivalents=(alike,),
                    candidates=candidates, missing_reason="a stop of the valve cuts the peaks of PV")
    return replace(case, study=study)


def modelled() -> Case:
    """A simulated loop with a lag in the base, a sine added, causes of its swing, and models that run: no search.

    The base has the true numbers, so that both effects show in its residual where they are left out.
    """
    lag, wave = "extra-lag", "sinusoidal-disturbance"
    setting, loop = small(lag, wave)
    force, most = float(loop.output[0]) - OPERATING_POINT, 0.5 * (setting.S + setting.J)
    steps = []
    for added, effects in ((None, (lag,)), (wave, (lag, wave))):
        model = Model(loop, Spec(effects=effects), s_max=float(np.ptp(loop.output)), period_s=40.0)
        at = model.vector({"S": setting.S, "J": setting.J, "dead_time_s": setting.plant.dead_time_s,
                           "initial_residual_force": float(np.clip(force / most, -1.0, 1.0)),
                           "time_constant_s": setting.plant.time_constant_s,
                           f"{lag}:second_time_constant_s": SMALL[lag][2]["second_time_constant_s"],
                           f"{wave}:period_s": SMALL[wave][2]["period_s"]})
        rows = tuple(ParameterValue(effect, name, value, "s") for effect, name, value in (
            (lag, "second_time_constant_s", SMALL[lag][2]["second_time_constant_s"]),
            (wave, "period_s", SMALL[wave][2]["period_s"])) if effect in effects)
        step = _step(None, model.evaluate(at).rmse, effects)
        fit = 100.0 * (1.0 - step.error.rmse / float(np.std(loop.process_value)))
        steps.append(replace(step, error=replace(step.error, fit_percent=fit), added=added,
                             parameters=(*step.parameters, *rows), model=model.describe(at)))
    gone = Candidate(wave, True, 0.05, 0.05, 0.05, 50.0, 20.0, -400.0, gain_beyond_noise=400.0)
    tree = (node(0, None, "root", "base", 0.4, -100.0, "named"), node(1, 0, "add", lag, 0.3, -400.0, "named"),
            node(2, 0, "add", "slew-limit", 0.4, -95.0, "looked"), node(3, 1, "add", wave, 0.05, -800.0, "named"))
    study = replace(searched(240).study, data=_data("FIC21", loop.samples), steps=tuple(steps), tree=tree,
                    candidates=(gone,), cost_map=None, adequate=False, adequate_reason="made up")
    return Case(study, loop, tuple(curves(study, loop)))


def doubtful(samples: int = 600) -> Case:
    """An estimate whose interval crosses bands, J weak, the model not adequate, the verdict undecided."""
    loop, curves = record(samples, S=1.4, J=0.3, noise=0.2, name="LIC7")
    estimate = Estimate(1.41, 0.33, "%", (0.84, 2.2), (0.0, 0.91), 0.9, "chen", 0.4, (31.0, 4.0), 2.5, False, 0.4)
    finding = Finding("residual-coloured", "warning", "the residual is correlated over 40 s", {"lag_s": 40.0},
                      ("coloured-noise", "random-walk-disturbance"), "autocorrelation, 99 % bounds")
    step = replace(_step(None, 0.31, (), (finding,)), error=ErrorSummary(0.31, 0.37, 0.22, 0.23, 0.2, 41.0, -510.0),
                   restarts=Restarts(8, 3))
    study = Study(MADE_BY, _data("LIC7", samples), _range(60.0, samples // 60),
                  Verdict("undecided", "with friction the held-out error falls by 8 % only", 0.44), estimate, (step,),
                  adequate=False, adequate_reason="the residual is correlated", cost_map=_map(1.41, 0.33))
    return Case(study, loop, (curves,))


def abstained() -> Case:
    """A constant controller output: no estimate, but data, range and reason are there."""
    loop = Loop(output=np.full(200, 43.0), process_value=20 + 0.1 * np.sin(np.arange(200) / 9.0), setpoint=np.full(
        200, 20.0), units={"output": "%", "process_value": "°C"}, name="TIC9")
    data = replace(_data("TIC9", 200), units={"process_value": "°C", "output": "%"}, options={}, findings=())
    reason = "the controller output is constant at 43 %"
    study = Study(MADE_BY, data, Range(False, None, None, None, (), reason), Verdict("undecided", reason), None)
    return Case(study, loop)


def hostile() -> Case:
    """Every foreign text of a study replaced by HOSTILE."""
    case = good(240)
    s = case.study
    data = replace(s.data, file=HOSTILE, sha256=HOSTILE,
                   columns=dict.fromkeys(s.data.columns, HOSTILE) | {HOSTILE: "a"},
                   units=dict.fromkeys(s.data.units, HOSTILE), start=HOSTILE, end=HOSTILE, name=HOSTILE,
                   findings=(Finding(HOSTILE, HOSTILE, HOSTILE, {HOSTILE: HOSTILE}, (HOSTILE,), HOSTILE),),
                   options={HOSTILE: HOSTILE})
    steps = tuple(replace(step, added=HOSTILE if step.added else None, effects=(HOSTILE,), findings=data.findings,
                          parameters=tuple(replace(p, effect=HOSTILE, name=HOSTILE, unit=HOSTILE, meaning=HOSTILE)
                                           for p in step.parameters)) for step in s.steps)
    candidates = tuple(replace(c, effect=HOSTILE, equivalent_to=(HOSTILE,), detectable_from=HOSTILE,
                               statement=HOSTILE, rejected_because=HOSTILE) for c in s.candidates)
    estimate = replace(s.estimate, unit=HOSTILE, law=HOSTILE)
    bad = Gate(HOSTILE, False, HOSTILE)
    tree = (TreeNode(0, None, Edge("root", HOSTILE), (HOSTILE,), HOSTILE, HOSTILE, {HOSTILE: 1.0}, 1.0, 1.0,
                     1.0, "named"),
            TreeNode(1, 0, Edge("add", HOSTILE), (HOSTILE,), HOSTILE, HOSTILE, {}, 0.5, 0.5, 0.5, "rejected", (bad,)))
    s = replace(s, tree=tree, unasked=(HOSTILE,), equivalents=(Equivalent(1, (HOSTILE,), 1.0, 1.0, 1.0, HOSTILE),),
                missing_reason=HOSTILE)
    study = replace(s, data=data, steps=steps, candidates=candidates, estimate=estimate, missing=(HOSTILE,),
                    laws=(LawResult(HOSTILE, 1.0, 1.0, None),), adequate_reason=HOSTILE, command=HOSTILE,
                    range=replace(s.range, reason=HOSTILE, unit=HOSTILE, reference=HOSTILE),
                    verdict=Verdict("stiction", HOSTILE, 0.5, Evidence(further={HOSTILE: HOSTILE})),
                    created_by=CreatedBy(HOSTILE, 1, HOSTILE, HOSTILE, HOSTILE))
    loop = replace(case.loop, units=data.units, name=HOSTILE)
    return Case(study, loop, case.curves)
