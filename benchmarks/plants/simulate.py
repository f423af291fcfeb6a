"""Closed loop of controller, sticking valve and process with hidden effects, written from the equations alone.

This module imports numpy and numba only. The time unit is the second, one scan of the controller takes 1 s, and the
loop is integrated at 1/20 of it. The process is advanced exactly for an input that is constant over such a part.

Force balance of the valve, with S = stickband plus deadband and J = slip jump in % of travel: f_s = (S + J)/2,
f_d = (S - J)/2. A stem at rest breaks away when |u - x| exceeds f_s, and comes to u - f_d (up) or u + f_d (down).

* `SLIDING`: it then follows u at the distance f_d until the command turns or stops.
* `RESTING`: it is at rest again before the next command arrives, so that each move needs f_s.
* `INERTIAL`: Karnopp's stem with mass, spring, viscous and Stribeck friction, integrated in parts of a millisecond.

A held command changes once a scan. A moving one comes from a controller that runs with the parts of a scan and sees y
without measurement noise; exports show it at the scans only. Order on the way: friction, travel stops, slew limit,
trim, load, dead time, gain of the process, lags, disturbance at the output, noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SLIDING, RESTING, INERTIAL = 0, 1, 2
PARTS = 20
STEP_S = 1.0 / PARTS
START = 50.0
# Parts of sqrt(m/k) in the integration of an inertial stem.
_STEM_PARTS = 40.0
_TIE = 1e-9


class Process(NamedTuple):
    """K e^{-L s} / ((T1 s + 1)(T2 s + 1)), over s where integrating (K then per second); T2 = 0 is no second lag."""

    gain: float
    time_constant_s: float
    dead_time_s: float
    second_time_constant_s: float = 0.0
    integrating: bool = False


class Controller(NamedTuple):
    """P, PI or PID. A zero `integral_time_s` is no integral part. The derivative acts on y through a lag `filter_s`.

    Inside |e| < `gap` the error counts by the factor `gap_gain` only.
    """

    gain: float
    integral_time_s: float = 0.0
    derivative_time_s: float = 0.0
    filter_s: float = 1.0
    gap: float = 0.0
    gap_gain: float = 1.0


class Valve(NamedTuple):
    """Friction, stops, speed and trim of a valve; `inertia_s` is sqrt(m/k), `damping` F_v / (2 sqrt(k m))."""

    S: float
    J: float
    kind: int = SLIDING
    jump_difference: float = 0.0
    stickband_growth: float = 0.0
    jump_growth: float = 0.0
    restick_speed: float = 0.0
    overshoot: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf
    rate: float = np.inf
    log_rangeability: float = 0.0
    inertia_s: float = 0.01
    damping: float = 1.2
    stribeck: float = 0.02


@dataclass(frozen=True)
class Noise:
    """Measurement noise: a white part, and a first-order autoregression; the root is that of exported samples."""

    white_sd: float = 0.0
    ar_sd: float = 0.0
    ar_root: float = 0.0


@dataclass(frozen=True)
class Setting:
    """Everything that makes one record; `setpoint` (scans,) has one value a scan.

    `effects` holds the hidden effects by their names in the catalogue, with their public parameters. `curved_setpoint`
    tells a setpoint that moves all the time from one that steps, for a moving command.
    """

    process: Process
    controller: Controller
    valve: Valve
    setpoint: FloatArray
    moving: bool = False
    curved_setpoint: bool = False
    export: int = 1
    rounding: float = 0.0
    noise: Noise = field(default_factory=Noise)
    effects: dict[str, dict[str, float | str]] = field(default_factory=dict)
    kick: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class Record:
    """Exported samples (n,): time, setpoint, output, process value, true stem; `tag` is a measured disturbance.

    `noise` (n,) is all noise in y, effects of that kind included; `noise_sd` is that of measurement noise and rounding
    alone. `command` (scans,) is the output at every scan, `scan_noise` (scans,) the measurement noise in y there.
    """

    t: FloatArray
    r: FloatArray
    u: FloatArray
    y: FloatArray
    stem: FloatArray
    tag: FloatArray | None
    noise: FloatArray
    noise_sd: float
    command: FloatArray
    scan_noise: FloatArray


@njit(cache=True)
def _gaps(valve: Valve, direction: float, seconds: float) -> tuple[float, float]:
    """Static and kinetic gap of one direction of travel at a time."""
    S = valve.S + valve.stickband_growth * seconds / 1000.0
    J = valve.J + valve.jump_growth * seconds / 1000.0 + 0.5 * direction * valve.jump_difference
    return 0.5 * (S + J), 0.5 * (S - J)


@njit(cache=True)
def _balance(valve: Valve, stem: FloatArray, u: float, step_s: float, seconds: float) -> None:
    """Stem without mass after one new value of the command; stem = position, speed, 1 if sliding, u, du before."""
    du = u - stem[3]
    keeps = stem[2] > 0.5 and du * stem[4] > 0.0 and abs(du) >= valve.restick_speed * step_s
    x, slides = stem[0], False
    if keeps:
        _, fd = _gaps(valve, np.sign(du), seconds)
        x = max(x, u - fd) if du > 0.0 else min(x, u + fd)
        slides = True
    if not slides:
        e = u - x
        way = 1.0 if e > 0.0 else -1.0
        fs, fd = _gaps(valve, way, seconds)
        if abs(e) > fs + _TIE:
            x += valve.overshoot * (e - way * fd)
            slides = valve.kind == SLIDING
    stopped = min(max(x, valve.lower), valve.upper)
    stem[0], stem[2] = stopped, 1.0 if slides and stopped == x else 0.0
    stem[3], stem[4] = u, du


@njit(cache=True)
def _swing(valve: Valve, stem: FloatArray, u: float, step_s: float, seconds: float) -> None:
    """Stem with mass over one part of a scan, under a command that goes straight from its last value to u."""
    parts = math.ceil(step_s * _STEM_PARTS / valve.inertia_s)
    h = step_s / parts
    x, v, last = stem[0], stem[1], stem[3]
    for j in range(parts):
        now = last + (u - last) * (j + 1) / parts
        e = now - x
        way = np.sign(v) if v != 0.0 else (1.0 if e > 0.0 else -1.0)
        fs, fd = _gaps(valve, way, seconds)
        if v == 0.0 and abs(e) <= fs + _TIE:
            if u == last:
                break
            continue
        if v == 0.0 and ((way > 0.0 and x >= valve.upper) or (way < 0.0 and x <= valve.lower)):
            continue
        friction = fd + (fs - fd) * math.exp(-((v / valve.stribeck) ** 2))
        push = (e - way * friction) / valve.inertia_s**2
        faster = (v + h * push) / (1.0 + 2.0 * h * valve.damping / valve.inertia_s)
        if faster * way <= 0.0:
            v = 0.0
            continue
        v = faster
        x += h * v
        if x > valve.upper or x < valve.lower:
            x, v = min(max(x, valve.lower), valve.upper), 0.0
    stem[0], stem[1], stem[3] = x, v, u


@njit(cache=True)
def _trim(x: float, a: float) -> float:
    """Flow in % of a valve with ln R = a at x % of travel; a negative a gives the mirror image."""
    return x if abs(a) < 1e-9 else 100.0 * np.expm1(0.01 * a * x) / np.expm1(a)


@njit(cache=True)
def _closed_loop(A: FloatArray, B: FloatArray, delay: int, gain: float, curvature: float, centre: float,
                 controller: Controller, valve: Valve, moving: bool, curved: bool, kick: float, setpoint: FloatArray,
                 output: FloatArray, load: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Output u, process value y without noise and stem position at every scan, (scans,) each."""
    scans, order = setpoint.size, B.size
    state, after = np.zeros(order), np.zeros(order)
    state[order - 1] = kick / gain
    queue = np.zeros(delay + 1)
    us, ys, xs = np.empty(scans), np.empty(scans), np.empty(scans)
    stem = np.array([START, 0.0, 0.0, START, 0.0])
    place, base = START, _trim(START, valve.log_rangeability)
    total, smooth, u = 0.0, 0.0, START
    dt = STEP_S if moving else 1.0
    for k in range(scans * PARTS):
        scan, part = k // PARTS, k % PARTS
        later, share = min(scan + 1, scans - 1), (part / PARTS if moving else 0.0)
        upset = output[scan] + share * (output[later] - output[scan])
        y = START + gain * state[order - 1] + upset
        acts = moving or part == 0
        if acts:
            r = setpoint[scan] + (share * (setpoint[later] - setpoint[scan]) if curved else 0.0)
            seen = y if moving else y + noise[scan]
            e = r - seen
            if abs(e) < controller.gap:
                e *= controller.gap_gain
            elif controller.gap > 0.0:
                e -= np.sign(e) * controller.gap * (1.0 - controller.gap_gain)
            wanted = START + controller.gain * e
            free = total
            if controller.integral_time_s > 0.0:
                free += controller.gain * e * dt / controller.integral_time_s
                wanted += free
            if controller.derivative_time_s > 0.0:
                before = smooth if k > 0 else seen
                smooth = seen + (before - seen) * math.exp(-dt / controller.filter_s)
                wanted -= controller.gain * controller.derivative_time_s * (smooth - before) / dt
            u = min(max(wanted, 0.0), 100.0)
            if u == wanted or (wanted > 100.0 and free < total) or (wanted < 0.0 and free > total):
                total = free
        seconds = k * STEP_S
        if valve.kind == INERTIAL:
            # A held command jumps at its scan: no straight line leads to it.
            if not moving:
                stem[3] = u
            _swing(valve, stem, u, STEP_S, seconds)
        elif acts:
            _balance(valve, stem, u, dt, seconds)
        reach = valve.rate * STEP_S
        place += min(max(stem[0] - place, -reach), reach)
        if part == 0:
            us[scan], ys[scan], xs[scan] = u, y, place
        pushed = load[scan] + share * (load[later] - load[scan])
        queue[k % (delay + 1)] = _trim(place, valve.log_rangeability) - base + pushed
        arrived = queue[(k + 1) % (delay + 1)] if k >= delay else 0.0
        if curvature != 0.0:
            arrived *= max(1.0 + curvature * (y - centre), 0.05)
        for i in range(order):
            after[i] = B[i] * arrived
            for j in range(order):
                after[i] += A[i, j] * state[j]
        state[:] = after
    return us, ys, xs


def _discrete(process: Process, extra_s: float) -> tuple[FloatArray, FloatArray]:
    """Exact transition (A, B) over one part of a scan of the lags in series and, last, the integrator."""
    lags = [t for t in (process.time_constant_s, process.second_time_constant_s, extra_s) if t > 0.0]
    order = len(lags) + int(process.integrating)
    whole = np.zeros((order + 1, order + 1))
    for i in range(order):
        lag = lags[i] if i < len(lags) else None
        whole[i, i - 1 if i else order] = 1.0 / lag if lag else 1.0
        if lag:
            whole[i, i] = -1.0 / lag
    # Exponential by a Taylor series of a 1/1024 of the step, raised to the 1024th power.
    small, term, total = whole * STEP_S / 1024.0, np.eye(order + 1), np.eye(order + 1)
    for i in range(1, 12):
        term = term @ small / i
        total = total + term
    done = np.linalg.matrix_power(total, 1024)
    return np.ascontiguousarray(done[:order, :order]), np.ascontiguousarray(done[:order, order])


def _lagged(signal: FloatArray, lag_s: float, dead_s: float) -> FloatArray:
    """A signal held from scan to scan behind a first-order lag and a dead time, at the scans."""
    late = np.interp(np.arange(signal.size) - dead_s, np.arange(signal.size), signal)
    out, keep = np.zeros(signal.size), math.exp(-1.0 / lag_s)
    for k in range(1, signal.size):
        out[k] = late[k - 1] + (out[k - 1] - late[k - 1]) * keep
    return out


def autoregressive(coefficients: tuple[float, ...], white: FloatArray) -> FloatArray:
    """d(k) = c1 d(k-1) + c2 d(k-2) + … + white(k), from zero."""
    out, held = np.empty(white.size), [0.0] * len(coefficients)
    for k, w in enumerate(white.tolist()):
        level = sum(c * h for c, h in zip(coefficients, held, strict=True)) + w
        out[k] = level
        held = [level, *held[:-1]]
    return out


def narrow_band(period_s: float, coherence_cycles: float) -> tuple[float, float, float]:
    """Coefficients of the resonant AR(2) at the scans, and its variance for innovations of variance 1."""
    radius = math.exp(-1.0 / (coherence_cycles * period_s))
    a1, a2 = 2.0 * radius * math.cos(2.0 * math.pi / period_s), -radius * radius
    return a1, a2, (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1**2))


def _disturbances(setting: Setting) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Disturbances (scans,) at the output, of the noise kind at the output, and at the load; tag of a measured one."""
    scans, effects = setting.setpoint.size, setting.effects
    time = np.arange(scans, dtype=np.float64)
    output, random, load, tag = np.zeros(scans), np.zeros(scans), np.zeros(scans), None
    for i, (name, given) in enumerate(sorted(effects.items())):
        rng = np.random.default_rng([setting.seed, 3, i])
        at = load if given.get("at") == "load" else output
        v = {key: float(value) for key, value in given.items() if key != "at"}
        if name == "step-disturbance":
            at += np.where(time >= v["time_s"], v["size"], 0.0)
        elif name == "ramp-disturbance":
            at += v["rate"] * np.maximum(time - v["start_s"], 0.0)
        elif name == "sinusoidal-disturbance":
            output += v["amplitude"] * np.sin(2.0 * np.pi * time / v["period_s"] + v["phase"])
        elif name == "random-walk-disturbance":
            # The parameter counts from one exported sample to the next.
            random += np.cumsum(v["innovation_sd"] / math.sqrt(setting.export) * rng.standard_normal(scans))
        elif name == "narrow-band-disturbance":
            a1, a2, variance = narrow_band(v["period_s"], v["coherence_cycles"])
            wave = autoregressive((a1, a2), rng.standard_normal(scans))
            random += wave * v["amplitude"] / math.sqrt(2.0 * variance)
        elif name == "measured-disturbance":
            pause = max(20.0 * v["lag_s"], 40.0 * setting.export)
            levels = rng.standard_normal(scans)
            tag = levels[np.cumsum(rng.random(scans) < 1.0 / pause)]
            output += v["gain"] * _lagged(tag, v["lag_s"], v["dead_time_s"])
    return output, random, load, tag


_OF_VALVE = {"stiction-drift", "re-sticking", "slip-overshoot", "travel-limit", "slew-limit", "valve-characteristic"}


def _hidden_valve(setting: Setting) -> Valve:
    """The valve with the numbers of all hidden effects that act on it."""
    valve = setting.valve
    for name, given in setting.effects.items():
        v = {key: float(value) for key, value in given.items() if key != "at"}
        if name in _OF_VALVE:
            valve = valve._replace(**v)
        if name == "asymmetric-stiction":
            up, down = v["jump_up"], v["jump_down"]
            valve = valve._replace(J=0.5 * (up + down), jump_difference=up - down)
        if name == "slip-overshoot" and valve.kind == INERTIAL:
            # K = 1 + exp(-pi z / sqrt(1 - z^2)): the stem itself overshoots.
            share = math.log(v["overshoot"] - 1.0) / math.pi
            valve = valve._replace(damping=-share / math.sqrt(1.0 + share * share), overshoot=1.0)
    # A sliding stem whose kinetic friction grows comes to rest between two values of a held command.
    if rests_by_drift(setting, valve):
        valve = valve._replace(kind=RESTING)
    return valve


def rests_by_drift(setting: Setting, valve: Valve) -> bool:
    """True where growing kinetic friction brings a sliding stem to rest under a held command."""
    return valve.kind == SLIDING and not setting.moving and valve.stickband_growth - valve.jump_growth > 0.0


def simulate(setting: Setting) -> Record:
    """The exported record of a setting; the same setting gives the same record."""
    scans, process, n = setting.setpoint.size, setting.process, setting.export
    lag = setting.effects.get("extra-lag", {}).get("second_time_constant_s", 0.0)
    A, B = _discrete(process, float(lag))
    valve = _hidden_valve(setting)
    output, random, load, tag = _disturbances(setting)
    rng = np.random.default_rng([setting.seed, 1])
    noise = setting.noise.white_sd * rng.standard_normal(scans)
    if setting.noise.ar_sd:
        root = setting.noise.ar_root ** (1.0 / n)
        white = np.random.default_rng([setting.seed, 2]).standard_normal(scans)
        # The first value has the variance of all others.
        white[1:] *= math.sqrt(1.0 - root * root)
        noise = noise + setting.noise.ar_sd * autoregressive((root,), white)
    # The slope of the trim at the start belongs to the process gain, so that the loop keeps its gain.
    slope = (_trim(START + 0.01, valve.log_rangeability) - _trim(START - 0.01, valve.log_rangeability)) / 0.02
    curvature = setting.effects.get("gain-nonlinearity", {}).get("curvature", 0.0)
    u, y, x = _closed_loop(A, B, round(process.dead_time_s / STEP_S), process.gain / slope, float(curvature),
                           float(setting.setpoint.mean()), setting.controller, valve, setting.moving,
                           setting.curved_setpoint, setting.kick, setting.setpoint, output + random, load, noise)
    shown_u, shown_y = u[::n].copy(), (y + noise)[::n]
    if setting.rounding:
        shown_u, shown_y = (np.round(a / setting.rounding) * setting.rounding for a in (shown_u, shown_y))
    sd = math.sqrt(float(np.var(noise[::n])) + setting.rounding**2 / 12.0)
    return Record(np.arange(shown_u.size) * float(n), setting.setpoint[::n].copy(), shown_u, shown_y, x[::n].copy(),
                  None if tag is None else tag[::n].copy(), (noise + random)[::n], sd, u, noise)


def innovation_sd(setting: Setting) -> float:
    """Standard deviation of the innovations of all noise in the exported samples: exp of the mean log spectrum.

    A random walk has a spectrum in differences only; the mean of log |1 - e^{-iw}|^2 is 0, so that both agree.
    """
    w = (np.arange(8192) + 0.5) * np.pi / 8192
    n, noise = setting.export, setting.noise
    spectrum = np.full(w.size, noise.white_sd**2 + setting.rounding**2 / 12.0)
    if noise.ar_sd:
        spectrum += noise.ar_sd**2 * (1.0 - noise.ar_root**2) / np.abs(1.0 - noise.ar_root * np.exp(-1j * w)) ** 2
    band = setting.effects.get("narrow-band-disturbance")
    if band:
        a1, a2, variance = narrow_band(float(band["period_s"]), float(band["coherence_cycles"]))
        for fold in range(n):
            z = np.exp(-1j * (w + 2.0 * np.pi * fold) / n)
            spectrum += float(band["amplitude"]) ** 2 / (2.0 * variance) / np.abs(1.0 - a1 * z - a2 * z * z) ** 2 / n
    walk = setting.effects.get("random-walk-disturbance")
    if walk:
        spectrum = spectrum * np.abs(1.0 - np.exp(-1j * w)) ** 2 + float(walk["innovation_sd"]) ** 2
    return float(np.exp(0.5 * np.mean(np.log(np.maximum(spectrum, 1e-300)))))
