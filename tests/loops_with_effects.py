"""Loops with a hidden effect and what counts as finding it: shared by tests and by the matrix of effects.

`loop_of` draws a loop from a seed, half of them scan-driven (20 integration steps a scan), a quarter with a command
that moves between samples, a quarter with a Karnopp valve under a held command; `SMALL` are fixed, quick ones, each
effect once and plainly visible.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stictionid.simulate import Controller, Plant, Setting, simulate

# Seeds below 1000 are for setting thresholds, from 10,000 on for reporting.
PLANTS = ((Plant(1.2, 20.0, 4.0), Controller(0.7, 12.0)), (Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0)),
          (Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0)), (Plant(0.8, 12.0, 2.0), Controller(1.2, 8.0)))
KINDS = ("scan", "scan", "moving", "karnopp")
# What a Karnopp valve itself may be named for: it rests between scans, or jumps past its place.
PHYSICAL = {"re-sticking", "slip-overshoot"}


def loop_of(seed: int, effect: str | None, noise: float, colour: float, samples: int):
    """One simulated loop: its setting, its record, and how it was made."""
    rng = np.random.default_rng([seed, 77])
    plant, controller = PLANTS[seed % len(PLANTS)]
    kind = KINDS[(seed // len(PLANTS)) % len(KINDS)]
    S = float(rng.uniform(3.0, 7.0))
    J = float(S * rng.uniform(0.35, 0.85))
    moves = [(0.0, float(rng.uniform(2.0, 4.0)))]
    if seed % 5:  # one loop in five has no setpoint change but the first
        moves += [(float(t) * samples, float(s)) for t, s in
                  zip((0.27, 0.5, 0.75), rng.uniform(2.0, 5.0, 3) * (-1, 1, -1), strict=True)]
    if effect == "valve-characteristic":
        # Over a short travel nothing tells a curve from a straight line: OP must move over some 15 % (CRITICISM.md
        # section 8).
        moves = [(0.0, 7.5 * plant.gain), *((t * samples, 15.0 * plant.gain * side)
                                            for t, side in ((0.27, -1), (0.5, 1), (0.75, -1)))]
    setting = Setting(plant, replace(controller, scan_s=0.0 if kind == "moving" else 1.0), S=S, J=J,
                      law="karnopp" if kind == "karnopp" else "chen", duration_s=float(samples),
                      setpoint_moves=tuple(moves))
    clean = simulate(setting, seed=seed).loop
    half = clean.process_value[samples // 4:]
    if np.ptp(half) < 0.2:  # this loop does not cycle by itself, so nothing could be identified
        moves += [(0.2 * samples * i, 3.0 * (-1) ** i) for i in (1, 2, 3, 4)]
        setting = replace(setting, setpoint_moves=tuple(moves))
        clean = simulate(setting, seed=seed).loop
        half = clean.process_value[samples // 4:]
    sd = noise * float(np.ptp(half))
    effects = []
    if effect:
        effects.append((effect, sized(effect, rng, setting, clean, sd)))
    if colour and effect not in ("coloured-noise", "random-walk-disturbance"):
        effects.append(("coloured-noise", {"root": colour, "innovation_sd": sd * float(np.sqrt(1.0 - colour**2))}))
    setting = replace(setting, effects=tuple(effects), noise_sd=0.0 if colour else sd)
    return setting, simulate(setting, seed=seed).loop, kind, sd


def sized(name: str, rng, s: Setting, clean, sd: float) -> dict:
    """Parameters of a hidden effect: large enough to show at this noise, small enough to be physical."""
    u = rng.uniform
    length, T = s.duration_s, s.plant.time_constant_s
    v = clean.position
    speeds = np.abs(np.diff(clean.output))
    speeds = speeds[speeds > 1e-9]
    sign = float(rng.choice([-1.0, 1.0]))
    swing = float(np.ptp(clean.process_value[clean.samples // 4:]))
    return {
        "asymmetric-stiction": lambda: {"jump_up": s.J * (1 + sign * u(0.25, 0.5)),
                                        "jump_down": s.J * (1 - sign * u(0.25, 0.5))},
        "stiction-drift": lambda: {"stickband_growth": s.S * u(0.15, 0.4) * 1000 / length,
                                   "jump_growth": s.J * u(0.0, 0.2) * 1000 / length},
        "re-sticking": lambda: {"restick_speed": float(np.quantile(speeds, u(0.4, 0.9)))},
        "slip-overshoot": lambda: {"overshoot": u(1.3, 1.8)},
        # A share of the travel, not of the time: a valve that dwells at its highest position would not feel a quantile.
        "travel-limit": lambda: {"upper": float(v.max() - u(0.15, 0.35) * np.ptp(v))} if sign > 0 else
            {"lower": float(v.min() + u(0.15, 0.35) * np.ptp(v))},
        "slew-limit": lambda: {"rate": s.J * u(0.05, 0.2)},
        "valve-characteristic": lambda: {"log_rangeability": sign * u(2.5, 4.5)},
        "gain-nonlinearity": lambda: {"curvature": sign * u(0.25, 0.5) / (0.5 * swing)},
        "extra-lag": lambda: {"second_time_constant_s": T * u(0.3, 0.8)},
        "sinusoidal-disturbance": lambda: {"period_s": T * u(3.0, 11.0), "amplitude": swing * u(0.05, 0.12),
                                           "phase": u(-3.0, 3.0)},
        "step-disturbance": lambda: {"time_s": length * u(0.25, 0.75), "size": sign * swing * u(0.1, 0.3),
                                     "at": str(rng.choice(["output", "load"]))},
        "ramp-disturbance": lambda: {"start_s": length * u(0.1, 0.5), "rate": sign * swing * u(0.3, 0.6) / length,
                                     "at": str(rng.choice(["output", "load"]))},
        "narrow-band-disturbance": lambda: {"period_s": T * u(1.5, 6.0), "coherence_cycles": u(2.0, 6.0),
                                            "amplitude": swing * u(0.05, 0.1)},
        "random-walk-disturbance": lambda: {"innovation_sd": sd * u(0.6, 1.5)},
        "coloured-noise": lambda: {"root": u(0.6, 0.9), "innovation_sd": sd},
        "measured-disturbance": lambda: {"lag_s": u(1.0, T), "dead_time_s": u(0.0, 5.0), "gain": swing * u(0.05, 0.15)},
    }[name]()


def right(row: dict) -> bool:
    """Whether the hidden effect came first or as an equivalent; a Karnopp valve may be named for its inertia."""
    truth, names = row["effect"], list(row["found"])
    if row["colour"]:  # coloured noise is there, so naming it is right
        names = [n for n in names if n != "coloured-noise"]
    if row["kind"] == "karnopp" and truth not in PHYSICAL:
        names = [n for n in names if n not in PHYSICAL]
    if truth == "none":
        return not names
    if truth in PHYSICAL and row["kind"] == "karnopp":
        return bool(set(row["found"]) & PHYSICAL)
    return bool(names) and (names[0] == truth or (truth in row["equivalent"] and len(names) <= 1))


# Small loops for tests: the plant (a number of PLANTS), S and J, setpoint moves, noise, and the effect's parameters.
MOVES = ((0.0, 3.0), (200.0, -4.0), (450.0, 5.0), (700.0, -3.0))
WIDE = ((0.0, 12.0), (150.0, -24.0), (300.0, 24.0), (450.0, -24.0), (600.0, 24.0), (750.0, -24.0))
NOISE, SAMPLES = 0.06, 900
SMALL: dict[str, tuple[int, tuple, dict[str, float | str]]] = {
    "asymmetric-stiction": (1, MOVES, {"jump_up": 3.4, "jump_down": 1.6}),
    "stiction-drift": (1, MOVES, {"stickband_growth": 1.2, "jump_growth": 0.3}),
    "re-sticking": (1, MOVES, {"restick_speed": 0.12}),
    "slip-overshoot": (1, MOVES, {"overshoot": 1.5}),
    "travel-limit": (1, MOVES, {"upper": 52.2}),
    "slew-limit": (1, MOVES, {"rate": 0.35}),
    "valve-characteristic": (1, WIDE, {"log_rangeability": 4.0}),
    "gain-nonlinearity": (1, MOVES, {"curvature": 0.08}),
    "extra-lag": (1, MOVES, {"second_time_constant_s": 4.0}),
    "sinusoidal-disturbance": (1, MOVES, {"period_s": 37.0, "amplitude": 0.5}),
    "step-disturbance": (1, MOVES, {"time_s": 500.0, "size": 1.2, "at": "output"}),
    "ramp-disturbance": (1, MOVES, {"start_s": 300.0, "rate": 0.004, "at": "output"}),
    "narrow-band-disturbance": (1, MOVES, {"period_s": 25.0, "coherence_cycles": 4.0, "amplitude": 0.4}),
    "random-walk-disturbance": (1, MOVES, {"innovation_sd": 0.06}),
    "coloured-noise": (1, MOVES, {"root": 0.8, "innovation_sd": 0.05}),
    "measured-disturbance": (1, MOVES, {"gain": 0.8, "lag_s": 8.0, "dead_time_s": 2.0}),
}


def small(*names: str, seed: int = 21, **more) -> tuple[Setting, object]:
    """The setting and record of a small loop with the effects of SMALL, or with none; `more` replaces settings."""
    plant, moves = (SMALL[names[0]][:2] if names else (1, MOVES))
    noise = 0.0 if "coloured-noise" in names else NOISE
    setting = Setting(PLANTS[plant][0], replace(PLANTS[plant][1], scan_s=1.0), S=4.0, J=2.5, duration_s=float(SAMPLES),
                      setpoint_moves=moves, noise_sd=noise, effects=tuple((n, dict(SMALL[n][2])) for n in names))
    setting = replace(setting, **more)
    return setting, simulate(setting, seed=seed).loop
