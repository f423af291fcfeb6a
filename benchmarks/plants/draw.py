"""Numbers of one loop, drawn for given levels of all factors and hidden effects, and drawn again until it cycles.

A loop without effects and noise is simulated first. Its swing sizes noise and effects. The loop with everything in it
must turn its valve at least ten times, keep u between its limits and not swing wider and wider.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .design import plain
from .simulate import (
    INERTIAL,
    RESTING,
    SLIDING,
    START,
    STEP_S,
    Controller,
    FloatArray,
    Noise,
    Process,
    Record,
    Setting,
    Valve,
    innovation_sd,
    rests_by_drift,
    simulate,
)

_TRIES = 60
_FEWEST_TURNS, _WANTED_TURNS = 10, 16
_SAMPLES_PER_PERIOD = 12.0
# The loop with its effect may swing this many times as far as without.
_RUNAWAY = 3.0
_KINDS = {"sliding": SLIDING, "resting": RESTING, "inertial": INERTIAL}


class NoLoop(RuntimeError):
    """No draw of a row gave a loop that cycles and stays in its limits."""


@dataclass(frozen=True)
class Plant:
    """One loop: how it was made, its record, and the truth for the table."""

    setting: Setting
    record: Record
    truth: dict[str, Any]


def turns(signal: FloatArray, threshold: float) -> int:
    """Reversals of a signal that go back by more than a threshold."""
    count, way, far = 0, 0, float(signal[0])
    for value in signal.tolist():
        if (way >= 0 and value > far) or (way <= 0 and value < far):
            far = value
            way = way or (1 if value > signal[0] else -1)
        elif abs(value - far) > threshold:
            count, way, far = count + (way != 0), (1 if value > far else -1), value
    return count


def drawn(levels: dict[str, str], effects: tuple[str, ...], seed: int) -> Plant:
    """The loop of a row of the design; NoLoop where none of the tries is acceptable."""
    for attempt in range(_TRIES):
        rng = np.random.default_rng([seed, 7, attempt])
        found = _attempt(levels, effects, rng, seed * _TRIES + attempt)
        if found is not None:
            setting, record = found
            return Plant(setting, record, _truth(setting, record, levels, effects, attempt))
    raise NoLoop(f"none of {_TRIES} draws cycles: {levels}, {effects}, seed {seed}")


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _process(levels: dict[str, str], rng: np.random.Generator) -> tuple[Process, float]:
    """A process, and the time scale by which everything else in the loop is sized, in seconds."""
    n, gain = int(levels["export"]), _log(rng, 0.5, 3.0)
    if levels["process"] == "integrating":
        lag = max(n * rng.uniform(1.0, 5.0), 1.0)
        dead = _rounded(max(n * rng.uniform(1.0, 5.0), 1.0))
        return Process(gain / (n * rng.uniform(20.0, 60.0)), lag, dead, 0.0, True), lag + dead
    lag = max(n * _log(rng, 5.0, 18.0), 4.0)
    dead = _rounded(lag * rng.uniform(0.15, 0.7))
    second = lag * rng.uniform(0.25, 0.6) if levels["process"] == "second-order" else 0.0
    return Process(gain, lag, dead, second), lag + dead + second


def _rounded(seconds: float) -> float:
    return round(seconds / STEP_S) * STEP_S


def _controller(kind: str, p: Process, rng: np.random.Generator) -> Controller:
    """Tuned after Skogestad's rules, with a random speed; half of a second lag counts as dead time."""
    half = 0.5 * (p.time_constant_s if p.integrating else p.second_time_constant_s)
    dead = p.dead_time_s + half + 0.5
    wanted = dead * rng.uniform(0.6, 1.4)
    if p.integrating:
        gain, integral = 1.0 / (p.gain * (wanted + dead)), 4.0 * (wanted + dead)
    else:
        lag = p.time_constant_s + half
        gain, integral = lag / (p.gain * (wanted + dead)), min(lag, 4.0 * (wanted + dead)) * rng.uniform(0.5, 0.95)
    if kind == "P":
        return Controller(gain * rng.uniform(0.8, 1.2))
    if kind == "PID":
        derivative = dead * rng.uniform(0.25, 0.5)
        return Controller(gain, integral, derivative, max(derivative / rng.uniform(3.0, 8.0), 1.0))
    return Controller(gain, integral)


def _setpoint(levels: dict[str, str], effects: tuple[str, ...], p: Process, c: Controller, scale: float, scans: int,
              rng: np.random.Generator) -> FloatArray:
    """Setpoint (scans,): constant, steps to and fro, or that of a master that moves it at every scan."""
    r = np.full(scans, START)
    if levels["excitation"] == "steady":
        return r
    wide = 2.0 if any(plain(e) == "valve-characteristic" for e in effects) else 1.0
    time = np.arange(scans)
    # Size in the unit of y that asks for some percent of u, at once and in the end.
    most = 14.0 * wide / c.gain
    size = min(most, (p.gain if not p.integrating else 1.0 / c.gain) * rng.uniform(3.0, 9.0) * wide)
    if levels["excitation"] == "moves":
        count = int(rng.integers(28, 44) if levels["controller"] == "P" else rng.integers(9, 16))
        at = np.sort((np.arange(1, count + 1) + rng.uniform(-0.3, 0.3, count)) / (count + 1) * scans).astype(int)
        for i, k in enumerate(at.tolist()):
            r[k:] = START + 0.5 * size * (-1.0) ** i * rng.uniform(0.6, 1.2)
        return r
    periods = scale * rng.uniform(5.0, 16.0, 2)
    wave = sum(a * np.sin(2.0 * np.pi * time / period + rng.uniform(0.0, 6.28))
               for a, period in zip((1.0, 0.6), periods, strict=True))
    wander, keep = np.zeros(scans), math.exp(-1.0 / (2.0 * scale))
    white = rng.standard_normal(scans)
    fast = 0.0
    for k in range(1, scans):
        fast = keep * fast + (1.0 - keep) * white[k]
        wander[k] = keep * wander[k - 1] + (1.0 - keep) * fast
    return r + 0.4 * size * (wave + 0.6 * wander / max(float(wander.std()), 1e-12))


def _attempt(levels: dict[str, str], effects: tuple[str, ...], rng: np.random.Generator,
             seed: int) -> tuple[Setting, Record] | None:
    n, samples = int(levels["export"]), int(rng.integers(1500, 3001))
    process, scale = _process(levels, rng)
    controller = _controller(levels["controller"], process, rng)
    S = rng.uniform(2.0, 7.0)
    valve = Valve(S, S * rng.uniform(0.3, 0.9), _KINDS[levels["valve"]], inertia_s=_log(rng, 0.005, 0.04),
                  damping=rng.uniform(0.9, 1.8), stribeck=_log(rng, 0.003, 0.03))
    if "asymmetric-stiction" in effects:
        valve = valve._replace(J=S * rng.uniform(0.35, 0.65))
    setpoint = _setpoint(levels, effects, process, controller, scale, samples * n, rng)
    kick = rng.uniform(0.5, 1.0) * S * (process.gain if not process.integrating else 0.7 / controller.gain)
    bare = Setting(process, controller, valve, setpoint, levels["command"] == "moving",
                   levels["excitation"] == "cascade", n, 0.0, Noise(), {}, kick * rng.choice([-1.0, 1.0]), seed)
    clean = simulate(bare)
    if not _cycles(bare, clean, _WANTED_TURNS):
        return None
    if levels["controller"] == "gap":
        controller = controller._replace(gap=0.5 * _swing(clean) * rng.uniform(0.1, 0.35),
                                         gap_gain=rng.uniform(0.2, 0.5))
        bare = replace(bare, controller=controller)
        clean = simulate(bare)
        if not _cycles(bare, clean, _WANTED_TURNS):
            return None
    swing = _swing(clean)
    noise = _noise(levels["noise"], swing, rng)
    sd = math.hypot(noise.white_sd, noise.ar_sd)
    hidden = {plain(name): _sized(name, bare, clean, scale, swing, sd, noise, rng) for name in effects}
    # Steps of twice the noise at the most: beyond that the record shows the steps only.
    rounding = min(_log(rng, 0.01, 0.1), max(2.0 * sd, 0.01)) if levels["rounding"] == "rounded" else 0.0
    setting = replace(bare, noise=noise, effects=hidden, rounding=rounding)
    record = simulate(setting)
    span, before = float(np.ptp(record.y)), float(np.ptp(clean.y))
    if span > _RUNAWAY * before or not _cycles(setting, record, _FEWEST_TURNS):
        return None
    return setting, record


def _swing(record: Record) -> float:
    """Swing of y by the cycle: that of y, or of its distance from the setpoint where setpoint moves are wider."""
    late = slice(record.y.size // 10, None)
    away = np.quantile(record.y[late] - record.r[late], [0.01, 0.99])
    return float(min(np.ptp(record.y[late]), away[1] - away[0]))


def _cycles(setting: Setting, record: Record, fewest: int) -> bool:
    """True where the valve turns often enough but not too fast, u keeps its limits, and the swing does not grow."""
    count = turns(record.stem, 0.25 * setting.valve.J)
    fits = 2.0 * record.stem.size >= _SAMPLES_PER_PERIOD * count
    inside = float(np.mean((record.command <= 0.5) | (record.command >= 99.5))) < 0.01
    thirds = [float(np.std(part)) for part in np.array_split(record.y - record.r, 3)]
    return fits and inside and count >= fewest and 0.4 * thirds[1] < thirds[2] < 1.8 * thirds[1]


def _noise(level: str, swing: float, rng: np.random.Generator) -> Noise:
    sd = swing * (0.05 if level == "white-5" else _log(rng, 0.005, 0.02))
    root = rng.uniform(0.5, 0.9)
    if level == "ar":
        return Noise(0.0, sd, root)
    return Noise(sd * math.sqrt(0.4), sd * math.sqrt(0.6), root) if level == "ar-white" else Noise(sd)


def _sized(name: str, setting: Setting, clean: Record, scale: float, swing: float, sd: float, noise: Noise,
           rng: np.random.Generator) -> dict[str, float | str]:
    """Public parameters of a hidden effect: large enough to show beside the noise, small enough to be physical."""
    u, valve = rng.uniform, setting.valve
    length, n = float(setting.setpoint.size), setting.export
    sign = float(rng.choice([-1.0, 1.0]))
    x, at = clean.stem[clean.stem.size // 10:], name.partition("@")[2]
    at_y = max(swing * u(0.2, 0.5), 4.0 * sd)
    # A load is in % of travel.
    step = at_y if at == "output" else valve.S * u(0.4, 1.0)
    speeds = np.abs(np.diff(clean.command))
    J = valve.J * u(0.3, 0.55)
    sizes: dict[str, dict[str, float | str]] = {
        "asymmetric-stiction": {"jump_up": valve.J + sign * J, "jump_down": valve.J - sign * J},
        "stiction-drift": {"stickband_growth": sign * valve.S * u(0.2, 0.4) * 1000.0 / length,
                           "jump_growth": sign * valve.J * u(0.0, 0.2) * 1000.0 / length},
        "re-sticking": {"restick_speed": float(np.quantile(speeds[speeds > 1e-9], u(0.5, 0.9)))},
        "slip-overshoot": {"overshoot": u(1.4, 1.8)},
        "travel-limit": {"upper": float(x.max() - u(0.15, 0.35) * np.ptp(x))} if sign > 0.0 else
                        {"lower": float(x.min() + u(0.15, 0.35) * np.ptp(x))},
        "slew-limit": {"rate": valve.J / max(scale * u(0.3, 1.0), 2.0 * n)},
        "valve-characteristic": {"log_rangeability": sign * u(2.5, 4.5)},
        "gain-nonlinearity": {"curvature": sign * u(0.3, 0.6) / (0.5 * float(np.ptp(clean.y)))},
        "extra-lag": {"second_time_constant_s": max(scale * u(0.4, 0.9), 2.0 * n)},
        "sinusoidal-disturbance": {"period_s": scale * u(3.0, 11.0), "amplitude": max(swing * u(0.08, 0.2), 3.0 * sd),
                                   "phase": u(-3.0, 3.0)},
        "step-disturbance": {"time_s": length * u(0.25, 0.75), "size": sign * step},
        "ramp-disturbance": {"start_s": length * u(0.1, 0.5), "rate": sign * step * u(1.0, 2.0) / length},
        "narrow-band-disturbance": {"period_s": max(scale * u(1.5, 6.0), 6.0 * n), "coherence_cycles": u(2.0, 6.0),
                                    "amplitude": max(swing * u(0.08, 0.15), 3.0 * sd)},
        "random-walk-disturbance": {"innovation_sd": min(sd * u(0.6, 1.5), 0.03 * swing)},
        "coloured-noise": {"root": noise.ar_root, "innovation_sd": noise.ar_sd * math.sqrt(1.0 - noise.ar_root**2)},
        "measured-disturbance": {"lag_s": max(scale * u(0.1, 1.0), 0.5 * n), "dead_time_s": scale * u(0.0, 0.5),
                                 "gain": max(swing * u(0.1, 0.25), 3.0 * sd)},
    }
    return {**sizes[plain(name)], "at": at} if at else sizes[plain(name)]


def _truth(setting: Setting, record: Record, levels: dict[str, str], effects: tuple[str, ...],
           attempt: int) -> dict[str, Any]:
    """All that the table asks of the truth, in plain types."""
    drift = setting.effects.get("stiction-drift", {})
    valve = setting.valve._replace(stickband_growth=float(drift.get("stickband_growth", 0.0)),
                                   jump_growth=float(drift.get("jump_growth", 0.0)))
    return {
        "S": setting.valve.S, "J": setting.valve.J, "levels": dict(levels), "hidden": list(effects),
        "effects": {name: dict(values) for name, values in setting.effects.items()},
        "noise_sd": record.noise_sd, "innovation_sd": innovation_sd(setting),
        "rests": setting.valve.kind != SLIDING or rests_by_drift(setting, valve),
        "second_lag": setting.process.second_time_constant_s > 0.0,
        "coloured": setting.noise.ar_sd > 0.0, "process": setting.process._asdict(),
        "controller": setting.controller._asdict(),
        "noise": [setting.noise.white_sd, setting.noise.ar_sd, setting.noise.ar_root],
        "inertia": [setting.valve.inertia_s, setting.valve.damping, setting.valve.stribeck],
        "rounding": setting.rounding,
        "samples": int(record.u.size), "attempt": attempt, "seed": setting.seed,
    }
