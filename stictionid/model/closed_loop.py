"""Simulation of the closed loop of Fig. 1: PI(D) controller, valve with stiction, linear process, measurement noise.

The loop is integrated as a continuous one (step at most `FINEST_STEP_S`) and sampled afterwards. A loop stepped at the
sampling time misses the paper's S_max by 3 to 15 %. With `scan_s` the controller works like a DCS: it computes once per
scan and holds its output. The valve law sees the held output once per scan. A physical law is advanced every
integration step. Its command is held or, without scans, moves in a straight line from step to step. Source: Shang et
al., Fig. 1 and Table 1, docs/details.md, section 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..effects.contract import Place
from ..errors import UsageError
from ..laws import get as get_law
from ..laws.contract import FS_DOWN, FS_UP, INTEGRAL, inner_loop, inner_start
from ..process.linear import Dynamics
from ..process.state_space import Element, Stepped
from ..record.loop import Loop, Origin
from ..typing import FloatArray
from .hidden_effects import hide

# Integration step of the continuous loop. Unit: s; docs/details.md, section 2 (0.05 s reproduces S_max within 1.7 %).
FINEST_STEP_S = 0.05
# Least number of steps in the fastest time constant.
_PARTS_PER_TIME_CONSTANT = 6
OPERATING_POINT = 50.0
# Largest number of integration steps (and samples) of one record: eleven days of a continuous loop, two minutes' work.
MOST_STEPS = 20_000_000
# Largest number that a setting may hold, in any unit; products of a few of them stay finite.
LARGEST = 1e12


@dataclass(frozen=True, slots=True)
class Controller:
    """PI(D) in the form of Shang et al., u = K_c (e + 1/T_i ∫ e + T_d de/dt); `scan_s` 0 means continuous."""

    gain: float
    integral_time_s: float
    derivative_time_s: float = 0.0
    scan_s: float = 0.0
    low: float = 0.0
    high: float = 100.0


@dataclass(frozen=True, slots=True)
class Plant:
    """Linear process K e^{-L s} / ((T1 s + 1)(T2 s + 1)), over s when integrating (K then per second)."""

    gain: float
    time_constant_s: float
    dead_time_s: float
    second_time_constant_s: float = 0.0
    integrating: bool = False


@dataclass(frozen=True, slots=True)
class Setting:
    """Arguments of `simulate`: plant, controller, valve, sampling, setpoint, noise; presets are instances of it."""

    plant: Plant
    controller: Controller
    S: float = 5.0
    J: float = 3.0
    law: str = "chen"
    law_values: tuple[tuple[str, float], ...] = ()
    step_s: float = 1.0
    duration_s: float = 1000.0
    setpoint_moves: tuple[tuple[float, float], ...] = ((0.0, 5.0),)
    noise_sd: float = 0.0
    quantise: float = 0.0
    effects: tuple[tuple[str, dict[str, float | str]], ...] = ()
    fine_step_s: float | None = None
    # Standard deviation of the break-away force from stroke to stroke. Unit: % of travel.
    scatter: float = 0.0


PRESETS = {
    "foptd": Setting(Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0)),
    "itptd": Setting(Plant(1.0, 0.3, 1.0, integrating=True), Controller(0.1, 5.0)),
    "tank": Setting(Plant(2.286, 180.0, 36.67), Controller(1.5, 180.0, scan_s=1.0), S=1.678, J=1.159,
                    duration_s=6000.0),
}


@dataclass(frozen=True, slots=True)
class Simulation:
    """The simulated record and the truth behind it (the contract's truth file)."""

    loop: Loop
    truth: dict[str, Any] = field(default_factory=dict)


def preset(name: str) -> Setting:
    """The preset called `name`; UsageError listing them where there is none."""
    if name not in PRESETS:
        raise UsageError(f"unknown preset '{name}'", "presets: " + ", ".join(PRESETS))
    return PRESETS[name]


def check_setting(setting: Setting) -> None:
    c, p = setting.controller, setting.plant
    for what, value, low in (
        ("--step", setting.step_s, 1e-6), ("--duration", setting.duration_s, setting.step_s),
        ("--noise", setting.noise_sd, 0.0), ("--scatter", setting.scatter, 0.0),
        ("--quantise", setting.quantise, 0.0), ("--scan", c.scan_s, 0.0),
        ("--time-constant", p.time_constant_s, 0.0), ("--second-time-constant", p.second_time_constant_s, 0.0),
        ("--dead-time", p.dead_time_s, 0.0), ("--td", c.derivative_time_s, 0.0), ("--kc", c.gain, -LARGEST),
        ("--gain", p.gain, -LARGEST), ("--ti", c.integral_time_s, -LARGEST),
        *(("--setpoint", value, -LARGEST) for move in setting.setpoint_moves for value in move),
    ):
        if math.isnan(value):
            raise UsageError(f"{what} nan is no number", f"give {what} {max(low, 1.0):g}, for example")
        if value < low:
            raise UsageError(f"{what} {value:g} is below its limit {low:g}", f"give {what} {low:g} or more")
        if value > LARGEST:
            raise UsageError(f"{what} {value:g} is above its limit {LARGEST:g}", f"give {what} 1, for example")
    if c.integral_time_s <= 0:
        raise UsageError(f"--ti {c.integral_time_s:g} s is not positive", "give seconds above 0")
    if p.gain == 0:
        raise UsageError(f"--gain {p.gain:g} moves nothing", "give a gain other than 0")
    if 0 < setting.quantise < 1 / LARGEST:
        raise UsageError(f"--quantise {setting.quantise:g} is finer than {1 / LARGEST:g}", "give 0 for none")
    samples = setting.duration_s / setting.step_s
    if samples > MOST_STEPS:
        raise UsageError(f"{samples:.3g} samples are more than {MOST_STEPS:,}", "give a shorter --duration")
    _check_fineness(setting)


def _check_fineness(setting: Setting) -> None:
    """Refuse a loop that would take more than MOST_STEPS integration steps."""
    c, p = setting.controller, setting.plant
    # Checked before the division: a scan or a lag far below the step would make more steps than a number can hold.
    for what, value in (("--scan", c.scan_s), ("--time-constant", p.time_constant_s),
                        ("--second-time-constant", p.second_time_constant_s)):
        if 0 < value < setting.step_s / MOST_STEPS:
            raise UsageError(f"{what} {value:g} s is too short beside the --step of {setting.step_s:g} s",
                             f"give {what} 0, or {setting.step_s / 100:g} s or more")
    if c.scan_s and abs(c.scan_s / setting.step_s - round(c.scan_s / setting.step_s)) > 1e-9 \
            and abs(setting.step_s / c.scan_s - round(setting.step_s / c.scan_s)) > 1e-9:
        raise UsageError(f"--scan {c.scan_s:g} s and --step {setting.step_s:g} s are not multiples of each other",
                         "give one as a whole multiple of the other")
    fine, per_sample = _fine_step(setting)
    for what, seconds in (("--duration", round(setting.duration_s / setting.step_s) * per_sample * fine),
                          ("--dead-time", p.dead_time_s)):
        if seconds / fine > MOST_STEPS:
            raise UsageError(f"{what} {seconds:g} s takes {seconds / fine:.3g} integration steps of {fine:g} s, more "
                             f"than {MOST_STEPS:,}", f"give a shorter {what}, or longer time constants and --scan")


def _fine_step(setting: Setting) -> tuple[float, int]:
    """Integration step in seconds and number of steps in one sample, so that scans and samples fall on steps."""
    grid = setting.step_s
    if setting.controller.scan_s:
        grid = min(grid, setting.controller.scan_s)
    lags = [t for t in (setting.plant.time_constant_s, setting.plant.second_time_constant_s) if t > 0]
    wanted = setting.fine_step_s or min([FINEST_STEP_S, *(t / _PARTS_PER_TIME_CONSTANT for t in lags)])
    parts = max(1, math.ceil(grid / wanted - 1e-9))
    return grid / parts, round(setting.step_s / (grid / parts))


class _Process:
    """Exact step response of the plant to an input held over a fine step; deviations from the operating point."""

    def __init__(self, plant: Plant, step_s: float, elements: tuple[Element, ...], closing: float, drift: float,
                 steps: int) -> None:
        self.gain, self.integrating, self.step = plant.gain, plant.integrating, step_s
        lags = [t for t in (plant.time_constant_s, plant.second_time_constant_s) if t > 0]
        self.decay = [math.exp(-step_s / t) for t in lags]
        self.falling = [math.exp(-step_s / (closing * t if i == 0 else t)) for i, t in enumerate(lags)]
        self.lag = [0.0] * len(lags)
        self.level = 0.0
        self.elements, self.ends = [Stepped(e, step_s) for e in elements], [0.0] * (len(elements) + 1)
        self.delay = plant.dead_time_s / step_s
        # Growth of the dead time in a step, in steps.
        self.growth = plant.dead_time_s * drift
        self.queue = [0.0] * (int(max(self.delay, self.delay + self.growth * steps) + 1e-9) + 2)
        self.at = 0

    def arrive(self, move: float) -> float:
        """Input of the process one dead time ago, with the present input held at `move` (deviation)."""
        queue, size = self.queue, len(self.queue)
        queue[self.at] = move
        whole = int(self.delay + 1e-9)
        newer = queue[(self.at - whole) % size]
        older = queue[(self.at - whole - 1) % size]
        self.at = (self.at + 1) % size
        fraction = max(self.delay - whole, 0.0)
        self.delay = max(self.delay + self.growth, 0.0)
        return newer + fraction * (older - newer)

    def advance(self, x: float) -> float:
        """Output after one fine step with the delayed input held at `x` (deviation)."""
        before = x
        for i, decay in enumerate(self.decay):
            start = self.lag[i]
            self.lag[i] = x + (start - x) * (decay if x >= start else self.falling[i])
            # The next lag sees the mean of this one over the step (exact to second order in the step).
            before, x = 0.5 * (start + self.lag[i]), (0.5 * (start + self.lag[i]) if i + 1 < len(self.decay)
                                                     else self.lag[i])
        if self.integrating:
            self.level += self.step * before if self.decay else self.step * x
            x = self.level
        for i, element in enumerate(self.elements):
            # An element whose input is held (no lag before it) sees no change within the step.
            mean = x if not (self.decay or self.integrating) and not i else 0.5 * (self.ends[i] + x)
            self.ends[i] = x
            x = element.advance(mean, x)
        return self.gain * x


def _setpoint(setting: Setting, time: FloatArray) -> FloatArray:
    r = np.full(time.size, OPERATING_POINT)
    for at, size in setting.setpoint_moves:
        r[time >= at - 1e-9] += size
    return r


def simulate(setting: Setting, *, seed: int = 0, disturbance: FloatArray | None = None) -> Simulation:
    """Run the closed loop of `setting` and sample it; the same seed gives the same record.

    `disturbance` (n,), in the unit of y, is added to the process value, for example from a neighbouring loop.

    Starts at rest with r = u = y = 50. The recorded u at a sample is the output just after the controller used
    that sample. A scanning controller sees the noisy, quantised y. A continuous one sees the process without noise.
    White noise has no meaning in continuous time, and held between samples it would stop the valve at every sample.
    Raises UsageError for values out of range and ModelError for S, J or `law_values` that the law refuses.
    """
    check_setting(setting)
    law = get_law(setting.law)
    rng = np.random.default_rng(seed)
    plant = setting.plant
    time = np.arange(round(setting.duration_s / setting.step_s), dtype=np.float64) * setting.step_s
    linear = Dynamics(np.array([plant.time_constant_s]), np.array([plant.dead_time_s]),
                      np.array([plant.second_time_constant_s]), plant.integrating)
    hidden = hide(setting.effects, S=setting.S, J=setting.J, plant=linear, time_s=time,
                  start=OPERATING_POINT, rng=np.random.default_rng([seed, 1]))
    found = hidden.plant
    setting = replace(setting, plant=replace(plant, time_constant_s=float(found.time_constant_s[0]),
                                             second_time_constant_s=float(found.second_time_constant_s[0])))
    _check_fineness(setting)
    fine, per_sample = _fine_step(setting)
    samples = time.size
    c = setting.controller
    scan = round(c.scan_s / fine) if c.scan_s else 0
    # Every measurement has noise of its own: each sample, and each scan where the controller scans faster.
    hold = min(scan, per_sample) if scan else per_sample
    noise = (setting.noise_sd * rng.standard_normal(-(-samples * per_sample // hold))).tolist()
    friction = law.friction(hidden.S, hidden.J, values=dict(setting.law_values), step_s=fine, held=bool(scan))
    friction = hidden.friction(friction, c.scan_s or fine, bool(scan))
    state = law.start(OPERATING_POINT, friction, np.zeros(1))
    process = _Process(setting.plant, fine, found.elements,
                       1.0 if found.closing is None else float(found.closing[0]),
                       0.0 if found.dead_time_drift is None else float(found.dead_time_drift[0]),
                       samples * per_sample)
    command, place, profile = np.full(1, OPERATING_POINT), np.empty((1, 1)), np.zeros(1)
    r_fine = _setpoint(setting, np.arange(samples * per_sample, dtype=np.float64) * fine).tolist()
    r, u_rec, y_rec, v_rec = _setpoint(setting, time), np.empty(samples), np.empty(samples), np.empty(samples)
    if disturbance is not None and np.shape(disturbance) != time.shape:
        raise UsageError(f"the disturbance has {np.size(disturbance)} samples, the record {time.size}",
                         "give one number a sample")
    # Between samples a disturbance is held for a scanning controller. For a continuous one it moves in a straight line
    # from sample to sample, or the controller's output would jump as no continuous one does.
    output, rise = _with_rise(hidden.output if disturbance is None else hidden.output + disturbance, per_sample, scan)
    load, load_rise = _with_rise(hidden.load, per_sample, scan)
    # The process rests at the operating point, whatever the effects make of the position.
    base = hidden.move(OPERATING_POINT, 0.0, 0.0, 1e9)
    gains = any(effect.place is Place.PROCESS for effect, _ in hidden.movers)
    y, u, total, e_last = 0.0, OPERATING_POINT, 0.0, 0.0
    run_law, dynamic, due = law.run, law.dynamic, False
    if friction[INTEGRAL].any():
        if dynamic:
            raise UsageError(f"the law {law.name} has forces of its own, and no positioner that integrates",
                             "leave the positioner out, or simulate with --law chen")
        friction[INTEGRAL] *= fine / (c.scan_s or fine)
        run_law, dynamic, state = inner_loop, True, inner_start(OPERATING_POINT, friction, np.zeros(1))
    run_law(command, friction, profile, state, place)
    if setting.scatter and law.slips is None:
        raise UsageError(f"slips of the law {law.name} have no break-away force that could scatter",
                         "simulate with --law chen or he")
    forces, draws = friction[[FS_UP, FS_DOWN]].copy(), np.random.default_rng([seed, 2])
    for k in range(samples * per_sample):
        sample, part = divmod(k, per_sample)
        upset = output[sample] + part * rise[sample]
        true = OPERATING_POINT + y + upset
        seen = true + noise[k // hold]
        for measured in hidden.measured:
            seen, true = measured(seen), measured(true)
        if setting.quantise:
            seen = round(seen / setting.quantise) * setting.quantise
        e = r_fine[k] - (seen if scan else true)
        if not scan or k % scan == 0:
            dt = c.scan_s if scan else fine
            free = total + c.gain / c.integral_time_s * dt * (e if scan else 0.5 * (e + e_last) if k else 0.0)
            wanted = OPERATING_POINT + c.gain * e + free
            if c.derivative_time_s and k:
                wanted += c.gain * c.derivative_time_s * (e - e_last) / dt
            u = min(max(wanted, c.low), c.high)
            if u == wanted or (wanted > c.high and free < total) or (wanted < c.low and free > total):
                total = free
            e_last = e
            command[0] = u
            due = True
        if due or dynamic:
            profile[0] = hidden.drift(k * fine)
            before = place[0, 0]
            run_law(command, friction, profile, state, place)
            if setting.scatter and place[0, 0] != before:
                # The next rest has a break-away force of its own, either way.
                friction[[FS_UP, FS_DOWN]] = forces + setting.scatter * draws.standard_normal(forces.shape)
            due = False
        if part == 0:
            y_rec[sample], u_rec[sample], v_rec[sample] = seen, u, place[0, 0]
        moved = hidden.move(place[0, 0], y + upset, k * fine, fine)
        x = process.arrive(moved - base + load[sample] + part * load_rise[sample])
        if gains:
            x = hidden.move(OPERATING_POINT + x, y + upset, k * fine, fine, arrived=True) - OPERATING_POINT
        y = process.advance(x)
    loop = Loop(output=u_rec, process_value=y_rec, setpoint=r, position=v_rec, step_s=setting.step_s, name="simulated",
                extras=hidden.extras,
                units={"output": "%", "process_value": "%", "setpoint": "%", "position": "%"}, origin=Origin())
    return Simulation(loop, _truth(setting, plant, seed))


def _with_rise(disturbance: FloatArray, per_sample: int, scan: int) -> tuple[list[float], list[float]]:
    """Disturbance (n,) at the samples, and its increment from one integration step to the next; 0 if held."""
    rise = np.zeros_like(disturbance) if scan else np.diff(disturbance, append=disturbance[-1:]) / per_sample
    return disturbance.tolist(), rise.tolist()


def _truth(setting: Setting, p: Plant, seed: int) -> dict[str, Any]:
    c = setting.controller
    J = setting.S if get_law(setting.law).one_parameter else setting.J
    return {
        "law": setting.law, "law_parameters": dict(setting.law_values), "S": setting.S, "J": J,
        "process": {"gain": p.gain, "time_constant_s": p.time_constant_s, "dead_time_s": p.dead_time_s,
                    "second_time_constant_s": p.second_time_constant_s, "integrating": p.integrating},
        "controller": {"gain": c.gain, "integral_time_s": c.integral_time_s,
                       "derivative_time_s": c.derivative_time_s, "scan_s": c.scan_s},
        "effects": [{"name": name, "parameters": dict(values)} for name, values in setting.effects],
        "noise_sd": setting.noise_sd, "scatter": setting.scatter, "seed": seed, "step_s": setting.step_s,
    }


def with_stiction(setting: Setting, S: float, J: float) -> Setting:
    """The same loop with another stickband plus deadband and slip jump."""
    return replace(setting, S=S, J=J)
