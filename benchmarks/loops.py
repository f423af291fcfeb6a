"""Random loops whose truth is known, for the tables of verdicts and intervals: half of them stick, half do not.

Processes of first to third order with SIMC-tuned PI controllers, scanned or continuous, 1 s samples; stiction S 0.5 to
8 %, J/S 0.1 to 1.2. Without stiction a sine, a neighbour's limit cycle, tight tuning, coloured noise or setpoint moves
make the loop move. Every loop has at least five cycles; noise is a share of the swing of y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.typing import FloatArray

CAUSES = ("sine", "elsewhere", "tight", "noise", "setpoint")
FEWEST = 5
_TRIES = 60
_NONE: dict[str, float | str] = {}


@dataclass(frozen=True, slots=True)
class Known:
    """One simulated loop and what is true of it; `cause` is "stiction" or what moves the loop instead.

    `noise_share` is the standard deviation of the noise as a share of the swing of y.
    """

    loop: Loop
    cause: str
    S: float
    J: float
    noise_sd: float
    setting: Setting
    noise_share: float = 0.0


def process(rng: np.random.Generator) -> tuple[Plant, tuple[tuple[str, dict[str, float | str]], ...], float]:
    """A random process, the effect that makes it third order, and the sum of its lags."""
    order = int(rng.integers(1, 4))
    T = float(np.exp(rng.uniform(np.log(4.0), np.log(25.0))))
    lags = [T, T * rng.uniform(0.15, 0.5), T * rng.uniform(0.1, 0.3)][:order]
    dead = float(rng.uniform(0.2, 1.0) * T)
    gain = float(np.exp(rng.uniform(np.log(0.5), np.log(3.0))))
    # A third lag and a dead time do the same; a distributed dead time stands for it.
    plant = Plant(gain, lags[0], dead + (lags[2] if order == 3 else 0.0), lags[1] if order > 1 else 0.0)
    return plant, (), sum(lags)


def tuned(plant: Plant, rng: np.random.Generator, scan_s: float) -> Controller:
    """SIMC (Skogestad 2003) with a random speed; the second lag goes half to the lag and half to the dead time."""
    T = plant.time_constant_s + 0.5 * plant.second_time_constant_s
    L = plant.dead_time_s + 0.5 * plant.second_time_constant_s
    wanted = L * rng.uniform(0.6, 1.5)
    return Controller(T / (plant.gain * (wanted + L)), min(T, 4.0 * (wanted + L)), scan_s=scan_s)


def ultimate_gain(plant: Plant, integral_time_s: float) -> float:
    """Controller gain at which the loop with this integral time just oscillates, from the frequency response."""
    w = np.geomspace(1e-4, 10.0, 20000)
    s = 1j * w
    g = plant.gain * np.exp(-plant.dead_time_s * s) / (plant.time_constant_s * s + 1)
    g = g / (plant.second_time_constant_s * s + 1) * (1 + 1 / (integral_time_s * s))
    phase = np.unwrap(np.angle(g))
    k = int(np.argmax(phase < -np.pi))
    return float(1.0 / abs(g[k]))


def noisy(setting: Setting, disturbance: FloatArray | None, share: float, colour: float, seed: int) -> Known | None:
    """The loop with measurement noise of a share of its swing, white or AR(1) with root `colour`."""
    quiet = simulate(setting, seed=seed, disturbance=disturbance).loop
    late = quiet.process_value[quiet.samples // 10:]
    swing = float(np.ptp(late))
    if swing <= 0.0:
        return None
    sd = share * swing
    if colour:
        setting = replace(setting, effects=(*setting.effects, ("coloured-noise", {
            "root": colour, "innovation_sd": sd * float(np.sqrt(1.0 - colour**2))})))
    else:
        setting = replace(setting, noise_sd=sd)
    loop = simulate(setting, seed=seed, disturbance=disturbance).loop
    found = find_range(loop)
    moves = len({at for at, _ in setting.setpoint_moves}) >= 2 * FEWEST
    if len(found.cycles) < FEWEST and not moves:
        return None
    if float(np.mean((loop.output <= 0.0) | (loop.output >= 100.0))) > 0.02:
        return None
    return Known(replace(loop, position=None), "", setting.S, setting.J, sd, setting, share)


def sticky(seed: int, *, colour: float = 0.0, samples: int = 1200) -> Known:
    """A loop whose valve sticks; noise 0.5 to 5 % of the swing of y."""
    rng = np.random.default_rng([seed, 17])
    for attempt in range(_TRIES):
        plant, effects, _ = process(rng)
        S = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0))))
        J = S * float(rng.uniform(0.1, 1.2))
        # Noise with a memory has a meaning between scans only where the controller scans.
        c = tuned(plant, rng, 1.0 if colour else float(rng.integers(0, 2)))
        setting = Setting(plant, c, S, J, duration_s=float(samples), setpoint_moves=((0.0, float(rng.uniform(-5, 5))),),
                          effects=effects)
        share = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
        known = noisy(setting, None, share, colour, seed * _TRIES + attempt)
        if known is not None:
            return replace(known, cause="stiction")
    raise RuntimeError(f"seed {seed} gives no loop with {FEWEST} cycles")


def walk(rng: np.random.Generator, samples: int, scale_s: float) -> FloatArray:
    """A load (samples,) that wanders, of swing 1: AR(1) with a memory of 0.5 to 3 times the lags of the process."""
    root = float(np.exp(-1.0 / (scale_s * rng.uniform(0.5, 3.0))))
    found = np.zeros(samples)
    for k in range(1, samples):
        found[k] = root * found[k - 1] + rng.standard_normal()
    return found / np.ptp(found)


def wandering(seed: int, *, samples: int = 1200) -> Known:
    """A sticking loop under a load that wanders by 0.1 to 0.5 of the swing of y."""
    known, rng = sticky(seed, samples=samples), np.random.default_rng([seed, 99])
    load = walk(rng, samples, known.setting.plant.time_constant_s)
    size = float(np.ptp(known.loop.process_value[samples // 10:]) * np.exp(rng.uniform(np.log(0.1), np.log(0.5))))
    loop = simulate(known.setting, seed=seed, disturbance=size * load).loop
    return replace(known, loop=replace(loop, position=None))


def clean(seed: int, cause: str, *, samples: int = 1200, S: float = 0.0) -> Known:
    """A loop that moves for another reason than its valve, which sticks by S (J half of it), or not at all."""
    rng = np.random.default_rng([seed, 23, CAUSES.index(cause)])
    for attempt in range(_TRIES):
        plant, effects, scale = process(rng)
        c = tuned(plant, rng, float(rng.integers(0, 2)))
        setting = Setting(plant, c, S, 0.5 * S, duration_s=float(samples), setpoint_moves=((0.0, 0.0),),
                          effects=effects)
        share = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
        colour, disturbance = 0.0, None
        period = float(np.exp(rng.uniform(np.log(20.0), np.log(160.0))))
        size = float(rng.uniform(1.0, 6.0))
        if cause == "sine":
            disturbance = size * np.sin(2 * np.pi * np.arange(samples) / period + rng.uniform(0, 6))
        elif cause == "elsewhere":
            other = sticky(int(rng.integers(1 << 30)), samples=samples).loop.process_value
            disturbance = size * (other - other.mean()) / np.ptp(other)
        elif cause == "tight":
            gain = ultimate_gain(plant, c.integral_time_s) * rng.uniform(0.9, 0.99)
            first = (0.0, float(rng.uniform(2, 6)))
            setting = replace(setting, controller=replace(c, gain=gain), setpoint_moves=(first,))
        elif cause == "noise":
            # A load that wanders: the controller follows it.
            disturbance = size * walk(rng, samples, scale)
        else:
            times = np.sort(rng.uniform(0, samples, int(rng.integers(12, 30))))
            level = np.cumsum(rng.uniform(-5, 5, times.size))
            moves = np.diff(np.clip(level, -10, 10), prepend=0.0)
            setting = replace(setting, setpoint_moves=tuple(zip(times.tolist(), moves.tolist(), strict=True)))
        known = noisy(setting, disturbance, share, colour, seed * _TRIES + attempt)
        if known is not None:
            return replace(known, cause=cause)
    raise RuntimeError(f"seed {seed} gives no {cause} loop with {FEWEST} cycles")
