"""Plants beyond the linear chain of simulate.py, drawn and run: ringing, a lag by direction, drifts, a stop in a tank.

The loop is written from the equations alone: a PI controller with a scan of 1 s, a stem without mass, and a process
that is integrated by Runge-Kutta steps of 1/20 s. In the equations w is the position one dead time ago, in % from the
start; y is K times the last state, and noise is added at the scans. None of it is code of the package.

    python benchmarks/plants/beyond.py --effect underdamped-process --loops 24 --seed 1000 --out rows.jsonl
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from numba import njit

from plants.draw import NoLoop, Plant, turns
from plants.simulate import PARTS, START, STEP_S, Controller, FloatArray, Noise, Process, Record, Setting, Valve

# Number of each process in `_change`: y is K times the first state, but for the inverse response and the drift.
RINGS, WRONG_WAY, BY_DIRECTION, GAIN_DRIFTS, LEAKS, THIRD_ORDER, DELAY_DRIFTS, POSITIONED, REPAIRED, TANK = range(10)
# Effects by name with their process; "clean" is a first order, and the last two are in no catalogue.
EFFECTS = {"clean": GAIN_DRIFTS, "underdamped-process": RINGS, "inverse-response": WRONG_WAY,
           "direction-dependent-lag": BY_DIRECTION, "gain-drift": GAIN_DRIFTS, "measurement-limit": GAIN_DRIFTS,
           "leak": LEAKS, "dead-time-drift": DELAY_DRIFTS, "stiction-change": REPAIRED, "load-noise": GAIN_DRIFTS,
           "random-load-steps": GAIN_DRIFTS, "travel-limit": TANK,
           "third-order-two-zeros": THIRD_ORDER, "positioner": POSITIONED}
_TRIES = 60
_FEWEST_TURNS, _SAMPLES_PER_TURN = 12, 14


@njit(cache=True)
def _change(kind: int, x: FloatArray, w: float, a: float, b: float, c: float) -> FloatArray:
    """Derivative of the states (3,) of a process of gain 1 under its input w; a, b and c are its numbers."""
    out = np.zeros(3)
    if kind == RINGS:
        # a^2 y'' + 2 b a y' + y = w
        out[0], out[1] = x[1], (w - x[0] - 2.0 * b * a * x[1]) / (a * a)
    elif kind in (WRONG_WAY, THIRD_ORDER):
        # Lags a and b in series; a third of length c where the order is three.
        out[0], out[1] = (w - x[0]) / a, (x[0] - x[1]) / b
        if kind == THIRD_ORDER:
            out[2] = (x[1] - x[2]) / c
    elif kind == BY_DIRECTION:
        out[0] = (w - x[0]) / (a if w > x[0] else a * b)
    elif kind in (LEAKS, TANK):
        # A lag a, then y' = x - y / b; b is infinite for a tank.
        out[0], out[1] = (w - x[0]) / a, x[0] - x[1] / b
    else:
        out[0] = (w - x[0]) / a
    return out


@njit(cache=True)
def _output(kind: int, x: FloatArray, a: float, b: float, c: float, seconds: float) -> float:
    """Output of gain 1."""
    if kind == WRONG_WAY:
        # (1 - c s): the second state less c times its derivative.
        return x[1] - c * (x[0] - x[1]) / b
    if kind == THIRD_ORDER:
        # (1 - c s)(1 + 2 c s), one zero in either half plane.
        slope, curve = (x[1] - x[2]) / c, ((x[0] - x[1]) / b - (x[1] - x[2]) / c) / c
        return x[2] + c * slope - 2.0 * c * c * curve
    if kind in (LEAKS, TANK):
        return x[1]
    return x[0] * (1.0 + b * seconds * 1e-5) if kind == GAIN_DRIFTS else x[0]


@njit(cache=True)
def _loop(kind: int, numbers: FloatArray, gain: float, delay: int, kc: float, ti: float, S: float, J: float,
          rests: bool, setpoint: FloatArray, noise: FloatArray, top: float,
          load: FloatArray, stops: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Output, process value without noise, and stem (scans,); the transmitter shows `top` at the most.

    `load` (scans,) in % of travel joins the stem, which moves between two `stops` (2,) in %."""
    scans, h = setpoint.size, STEP_S
    a, b, c = numbers
    us, ys, vs = np.empty(scans), np.empty(scans), np.empty(scans)
    # The dead time grows by b % in 1000 s where it drifts.
    growth = delay * b * 1e-5 * h if kind == DELAY_DRIFTS else 0.0
    inner, whole, jump = 0.0, S, J
    sent, x = np.zeros(scans * PARTS), np.zeros(3)
    stem, total, last, before, slides = START, 0.0, START, 0.0, False
    for k in range(scans * PARTS):
        if kind == REPAIRED:
            # S and J are b times as large from c seconds on.
            S, J = (b * whole, b * jump) if k * h >= c else (whole, jump)
        y = START + gain * _output(kind, x, a, b, c, k * h)
        if k % PARTS == 0:
            scan = k // PARTS
            e = setpoint[scan] - min(y + noise[scan], top)
            total += kc * e / ti
            u = START + kc * e + total
            du, held = u - last, True
            if kind == POSITIONED:
                held = False
            elif slides and not rests and du * before > 0.0:
                stem, held = u - np.sign(du) * 0.5 * (S - J), False
            if held:
                slides = abs(u - stem) > 0.5 * (S + J)
                if slides:
                    stem = u - np.sign(u - stem) * 0.5 * (S - J)
            if not stops[0] <= stem <= stops[1]:
                # A stem at a stop rests there, until friction lets it go back.
                stem, slides = min(max(stem, stops[0]), stops[1]), False
            last, before = u, du
            us[scan], ys[scan], vs[scan] = u, y, stem
        if kind == POSITIONED:
            # A positioner adds the integral of the stem's error to the command, over b seconds, until the stem slips.
            inner += h * (last - stem) / b
            force = last + inner
            if abs(force - stem) > 0.5 * (S + J):
                stem = force - np.sign(force - stem) * 0.5 * (S - J)
        sent[k] = stem - START + load[k // PARTS]
        late = delay + growth * k
        older = math.ceil(late)
        w = 0.0
        if k >= older:
            w = sent[k - older]
            if older > late:
                w += (older - late) * (sent[k - older + 1] - w)
        k1 = _change(kind, x, w, a, b, c)
        k2 = _change(kind, x + 0.5 * h * k1, w, a, b, c)
        k3 = _change(kind, x + 0.5 * h * k2, w, a, b, c)
        k4 = _change(kind, x + h * k3, w, a, b, c)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return us, ys, vs


def drawn_beyond(effect: str, seed: int) -> Plant:
    """A loop with one of `EFFECTS`; NoLoop where none of the tries cycles."""
    for attempt in range(_TRIES):
        found = _attempt(effect, np.random.default_rng([seed, 11, attempt]), seed)
        if found is not None:
            return found
    raise NoLoop(f"none of {_TRIES} draws cycles: {effect}, seed {seed}")


def _attempt(effect: str, rng: np.random.Generator, seed: int) -> Plant | None:
    u, kind = rng.uniform, EFFECTS[effect]
    lag, dead, gain = float(u(8.0, 25.0)), round(float(u(2.0, 8.0)) / STEP_S) * STEP_S, float(u(0.6, 2.5))
    S = float(u(2.5, 6.0))
    J, rests = S * float(u(0.35, 0.85)), bool(rng.random() < (0.5 if kind == TANK else 0.25))
    samples = int(rng.integers(1400, 2200))
    numbers, given, slow = _numbers(effect, lag, samples, rng)
    # Skogestad's rules for a lag with the dead time and the further lags; slower for a process that rings.
    wait = dead + slow + 0.5
    fast = 2.0 * wait * float(u(0.7, 1.3))
    kc, ti = (1.0 / (gain * fast), 4.0 * fast) if kind in (LEAKS, TANK) else \
        (lag / (gain * fast), lag * float(u(0.5, 0.9)))
    if kind == RINGS:
        kc, ti = float(u(0.25, 0.5)) / gain, numbers[0] * float(u(1.0, 1.6))
    times = np.cumsum(u(0.12, 0.3, 4)) * samples
    setpoint = np.full(samples, START) + float(u(1.0, 3.0))
    for at, size in zip(times.astype(int), u(1.5, 4.0, 4) * (-1.0) ** np.arange(4), strict=True):
        setpoint[at:] += size
    if kind == TANK:
        # Moves of some percent of the output.
        setpoint = START + (setpoint - START) / kc
    arguments = (kind, np.array(numbers), gain, round(dead / STEP_S), kc, ti, S, J, rests, setpoint)
    none, stops = np.zeros(samples), np.array([-np.inf, np.inf])
    clean = _loop(*arguments, none, np.inf, none, stops)
    swing = float(np.ptp(clean[1][samples // 10:] - setpoint[samples // 10:]))
    sd = 0.5 * swing * float(np.exp(u(math.log(0.006), math.log(0.03))))
    noise = sd * rng.standard_normal(samples)
    top = np.inf
    if effect == "measurement-limit":
        top = float(np.quantile(clean[1], u(0.85, 0.95)))
        given = {"upper": top}
    if effect == "stiction-change":
        more = numbers[1] - 1.0
        given = {"stickband_change": more * S, "jump_change": more * J, "time_s": numbers[2]}
    load = none
    if effect in ("load-noise", "random-load-steps"):
        load, given = _drawn_load(effect, swing / gain, samples, rng)
    if effect == "travel-limit":
        at, moved = int(rng.integers(2)), clean[2][samples // 10:]
        ends = np.array([moved.min(), moved.max()])
        stops[at] = ends[at] + (1.0 - 2.0 * at) * float(u(0.15, 0.35)) * np.ptp(moved)
        given = {("lower", "upper")[at]: float(stops[at])}
    out, y, stem = _loop(*arguments, noise, top, load, stops)
    count = turns(stem, 0.25 * J)
    wide = np.ptp(y) > 4.0 * np.ptp(clean[1]) or max(out.max() - 98.0, 2.0 - out.min()) > 0.0
    if not _FEWEST_TURNS <= count <= samples / _SAMPLES_PER_TURN or wide:
        return None
    setting = Setting(Process(gain, lag, dead), Controller(kc, ti), Valve(S, J), setpoint, noise=Noise(sd), seed=seed)
    record = Record(np.arange(samples, dtype=np.float64), setpoint, out, np.minimum(y + noise, top), stem, None, noise,
                    sd, out, noise)
    now = numbers[1] if effect == "stiction-change" else 1.0
    truth = {"S": now * S, "J": now * J, "levels": {}, "hidden": [] if effect == "clean" else [effect],
             "effects": {effect: given},
             "noise_sd": sd, "innovation_sd": sd, "rests": rests, "second_lag": kind == LEAKS, "coloured": False,
             "process": setting.process._asdict(), "controller": setting.controller._asdict(), "samples": samples,
             "rounding": 0.0, "seed": seed}
    return Plant(setting, record, truth)


def _drawn_load(effect: str, swing: float, samples: int,
                rng: np.random.Generator) -> tuple[FloatArray, dict[str, float]]:
    """A load (samples,) in % of travel and its public parameters, for a swing of y over the gain."""
    u = rng.uniform
    if effect == "random-load-steps":
        interval, size = samples / float(u(6.0, 15.0)), swing * float(u(0.2, 0.5))
        steps = np.where(rng.random(samples) < 1.0 / interval, size * rng.standard_normal(samples), 0.0)
        return np.cumsum(steps), {"interval_s": interval, "size": size}
    root, sd = float(rng.choice([u(0.5, 0.98), 1.0])), swing * float(u(0.02, 0.08))
    load, level = np.zeros(samples), 0.0
    for k, white in enumerate(rng.standard_normal(samples).tolist()):
        load[k] = level = root * level + sd * white
    return load, {"root": root, "innovation_sd": sd}


def _numbers(effect: str, lag: float, samples: int, rng: np.random.Generator,
             ) -> tuple[tuple[float, float, float], dict[str, float], float]:
    """Numbers of a process, public parameters of its effect, and seconds by which it is slower than one lag."""
    u = rng.uniform
    if effect == "underdamped-process":
        tau, damping = float(u(4.0, 10.0)), float(u(0.2, 0.6))
        return (tau, damping, 0.0), {"natural_period_s": 2.0 * math.pi * tau, "damping": damping}, tau
    if effect == "inverse-response":
        second, zero = lag * float(u(0.15, 0.6)), lag * float(u(0.2, 0.6))
        return (lag, second, zero), {"zero_s": zero, "lag_s": second}, 0.5 * second + zero
    if effect == "direction-dependent-lag":
        ratio = float(np.exp(rng.choice([-1.0, 1.0]) * u(math.log(1.4), math.log(2.5))))
        return (lag, ratio, 0.0), {"closing_ratio": ratio}, 0.0
    if effect == "dead-time-drift":
        drift = float(rng.choice([u(-80.0, -50.0), u(80.0, 200.0)])) * 1e3 / samples
        return (lag, drift, 0.0), {"drift": drift}, 0.0
    if effect == "gain-drift":
        drift = float(rng.choice([u(-45.0, -20.0), u(25.0, 80.0)])) * 1e3 / samples
        return (lag, drift, 0.0), {"drift": drift}, 0.0
    if effect == "travel-limit":
        return (0.3 * lag, math.inf, 0.0), {}, 0.15 * lag
    if effect == "leak":
        return (0.3 * lag, 25.0 * lag, 0.0), {"leak": 1e3 / (25.0 * lag)}, 0.15 * lag
    if effect == "stiction-change":
        return (lag, float(rng.choice([u(0.15, 0.4), u(2.0, 3.0)])), float(u(0.3, 0.7)) * samples), {}, 0.0
    if effect == "positioner":
        seconds = float(u(10.0, 60.0))
        return (lag, seconds, 0.0), {"integral_rate": 1.0 / seconds}, 0.0
    if effect == "third-order-two-zeros":
        return (lag, 0.6 * lag, 0.35 * lag), {}, lag
    return (lag, 0.0, 0.0), {}, 0.0


def main() -> None:
    """Draw, run and judge the loops, one JSON line each; rows already in the file are skipped."""
    from plants.score import run

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", required=True, choices=EFFECTS)
    parser.add_argument("--loops", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    rows = [json.loads(line) for line in a.out.read_text().splitlines()] if a.out.exists() else []
    done = {(row["effect"], row["seed"]) for row in rows}
    with a.out.open("a") as file:
        for number in range(a.loops):
            seed = a.seed + number
            if (a.effect, seed) in done:
                continue
            row = {"effect": a.effect, "seed": seed} | run(drawn_beyond(a.effect, seed))
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
            print(_line(row), file=sys.stderr, flush=True)
    _summary([row for row in rows if row["effect"] == a.effect])


def _line(row: dict[str, Any]) -> str:
    if "S_error" not in row:
        return f"{row['effect']} {row['seed']} -> {row.get('error') or row.get('reason')}"
    return (f"{row['effect']} {row['seed']} -> {row['right']} {'+'.join(row['answer']) or 'nothing'} {row['verdict']} "
            f"error {row['error_over_noise']:.2f} S {100 * row['S_error']:+.1f} % J {100 * row['J_error']:+.1f} % "
            f"{row['cpu_s']:.1f} s {row['truth']['effects']} found {row['found']}")


def _summary(rows: list[dict[str, Any]]) -> None:
    good = [row for row in rows if "S_error" in row]
    if good:
        seconds = sum(row["cpu_s"] for row in good) / len(good)
        print(f"{len(rows)} loops: right {sum(row['right'] != 'wrong' for row in good)}, stiction "
              f"{sum(row['verdict'] == 'stiction' for row in good)}, S within 2 % "
              f"{sum(row['S_good'] for row in good)}, error within 5 % of the noise "
              f"{sum(row['error_good'] for row in good)}, CPU {seconds:.1f} s each")


if __name__ == "__main__":
    main()
