"""Simulated loops with hidden effects and the criterion for finding them, for tests and the effects matrix.

`loop_of` draws a loop from a seed: six plants, half of the loops scan-driven (20 integration steps a scan). A quarter
has a command that moves between samples, a quarter a Karnopp valve under a held command. `shown` tells from the truth
alone what a record can show. `SMALL` are fixed, quick loops, each effect once and plainly visible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stictionid.effects import catalogue, get
from stictionid.fit.fit import one_run
from stictionid.fit.points.moves import descend_model, first_force
from stictionid.model.closed_loop import OPERATING_POINT, Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import FEWEST_REVERSALS, swing_of, time_scale_s

PLANTS = ((Plant(1.2, 20.0, 4.0), Controller(0.7, 12.0)), (Plant(2.0, 6.0, 3.0), Controller(0.15, 6.0)),
          (Plant(3.0, 5.0, 5.0), Controller(0.1, 5.0)), (Plant(0.8, 12.0, 2.0), Controller(1.2, 8.0)),
          (Plant(0.02, 4.0, 3.0, integrating=True), Controller(1.5, 80.0)))


@dataclass(frozen=True, slots=True)
class Bed:
    """A plant with its controller, the sampling step, and the time scale that sizes of hidden effects go by."""

    kind: str
    plant: Plant
    controller: Controller
    scale_s: float
    step_s: float = 1.0


BEDS = (Bed("slow first order", *PLANTS[0], 20.0),
        Bed("fast first order", *PLANTS[1], 6.0),
        Bed("first order with dead time", *PLANTS[2], 5.0),
        Bed("second order", Plant(1.5, 10.0, 2.0, 4.0), Controller(0.5, 10.0), 10.0),
        Bed("integrator", Plant(1.0, 0.3, 1.0, integrating=True), Controller(0.1, 5.0), 4.0),
        Bed("tank", Plant(2.286, 180.0, 36.67), Controller(1.5, 180.0), 180.0, 4.0))
KINDS = ("scan", "moving", "scan", "karnopp")
# Integration steps a scan (docs/details.md: the identifier's own grid must not have made the data).
_PARTS = 20
# Steps through the beds and kinds from one effect to the next, coprime to their number: 24 seeds give every effect
# every bed with every kind, and a single seed has the effects spread over them.
_STRIDE = 5
# Effects beyond the linear chain of first design; their loops are in benchmarks/plants/beyond.py, too.
BEYOND = ("backlash", "direction-dependent-lag", "gain-drift", "inverse-response", "leak", "load-noise",
          "measurement-filter", "measurement-limit", "underdamped-process", "dead-time-drift", "positioner",
          "stiction-change", "random-load-steps")
# What a Karnopp valve itself may be named for: it rests between scans, or jumps past its place.
PHYSICAL = {"re-sticking", "slip-overshoot"}
# An effect that leaves less than this share of the noise after a refit without it makes the error 8 % larger than the
# noise at most: a model within 5 % of the estimated noise is adequate (docs/details.md, section 10.1). Unit: 1.
VISIBLE = 0.4
# Lags, as multiples of the true one, from which the model without an effect is fitted: a lag can stand for another.
_LAGS = np.array([1.0, 2.0, 8.0])
# Initial residual forces, as shares of f_s, that are tried with each: no descent crosses from one first slip to the
# next.
_FORCES = np.linspace(-0.98, 0.98, 197)
# A loop that swings more than this many times as far with its effect has run away: nobody would look for stiction.
_RUNAWAY = 3.0


def names_of(effect: str | None) -> list[str]:
    """The hidden effects of a loop by name: none, one, or a pair joined by "+"."""
    return effect.split("+") if effect and effect != "none" else []


def loop_of(seed: int, effect: str | None, noise: float, colour: float, samples: int,
            fewest: int = FEWEST_REVERSALS):
    """One simulated loop: its setting, its record, how it was made (kind and bed), and the noise sd in the unit of y.

    `effect` is None, a name, or two joined by "+". Where it leaves the valve turning less than `fewest` times setpoint
    moves are added.
    """
    rng = np.random.default_rng([seed, 77])
    # Later effects come after the others, so that loops stay as they were.
    known = sorted(catalogue(), key=lambda name: BEYOND.index(name) + 1 if name in BEYOND else 0)
    at = (seed + _STRIDE * sum((1 + i) * (1 + known.index(name)) for i, name in enumerate(names_of(effect)))) \
        % (len(BEDS) * len(KINDS))
    bed, kind = BEDS[at % len(BEDS)], KINDS[at // len(BEDS)]
    S = float(rng.uniform(3.0, 7.0))
    J = float(S * rng.uniform(0.35, 0.85))
    length = samples * bed.step_s
    moves = [(0.0, float(rng.uniform(2.0, 4.0)))]
    if seed % 5:  # one loop in five has no setpoint change but the first
        moves += [(float(t) * length, float(s)) for t, s in
                  zip((0.27, 0.5, 0.75), rng.uniform(2.0, 5.0, 3) * (-1, 1, -1), strict=True)]
    if "valve-characteristic" in names_of(effect):
        # Over a short travel nothing tells a curve from a straight line: OP must move over some 15 % (docs/details.md,
        # section 10).
        moves = [(0.0, 7.5 * bed.plant.gain), *((t * length, 15.0 * bed.plant.gain * side)
                                                for t, side in ((0.27, -1), (0.5, 1), (0.75, -1)))]
    setting = Setting(bed.plant, replace(bed.controller, scan_s=0.0 if kind == "moving" else bed.step_s), S=S, J=J,
                      law="karnopp" if kind == "karnopp" else "chen", duration_s=length, step_s=bed.step_s,
                      setpoint_moves=tuple(moves), fine_step_s=bed.step_s / _PARTS)
    clean = simulate(setting, seed=seed).loop
    half = clean.process_value[samples // 4:]
    if np.ptp(half) < 0.2:  # this loop does not cycle by itself, so nothing could be identified
        moves += [(0.2 * length * i, 3.0 * (-1) ** i) for i in (1, 2, 3, 4)]
        setting = replace(setting, setpoint_moves=tuple(moves))
        clean = simulate(setting, seed=seed).loop
        half = clean.process_value[samples // 4:]
    sd = noise * float(np.ptp(half))
    effects = [(name, sized(name, rng, setting, bed.scale_s, clean, sd)) for name in names_of(effect)]
    if colour and not {"coloured-noise", "random-walk-disturbance"} & set(names_of(effect)):
        effects.append(("coloured-noise", {"root": colour, "innovation_sd": sd * float(np.sqrt(1.0 - colour**2))}))
    coloured = any(name == "coloured-noise" for name, _ in effects)
    setting = replace(setting, effects=tuple(effects), noise_sd=0.0 if coloured else sd)
    loop = simulate(setting, seed=seed).loop
    if names_of(effect) and turns(loop.position) < fewest:
        # With what is hidden, or under large setpoint changes, the loop settles: a valve that hardly turns shows no
        # friction, and to abstain would be right.
        setting = replace(setting, setpoint_moves=_further(setting.setpoint_moves, length))
        loop = simulate(setting, seed=seed).loop
    # What is asked is what y shows: a plant that records the position knows whether its valve sticks.
    return setting, replace(loop, position=None), (kind, bed.kind), sd


def turns(position: np.ndarray) -> int:
    """How often a valve turns, from its positions (n,)."""
    directions = np.sign(np.diff(position))
    directions = directions[directions != 0.0]
    return int((directions[1:] != directions[:-1]).sum())


def _further(moves: Sequence[tuple[float, float]], length: float) -> tuple[tuple[float, float], ...]:
    """Setpoint moves with as many again and two more: evenly over the record, to and fro, as large as the largest."""
    count, size = len(moves) + 4, max(abs(move) for _, move in moves[1:] or moves)
    return (moves[0], *((length * i / count, size * (-1.0) ** i) for i in range(1, count)))


def shown(setting: Setting, loop: Loop, name: str, sd: float) -> float:
    """How far hidden effect `name` moves y, as a share of the noise: root mean square over the record.

    The true model is run under the recorded output with the effect, and one without it is fitted to that, from the
    true values on and by a search of its own (a slip that overshoots is another slip jump where the valve never
    slides): what is left could be seen. Noise effects, which move no free run, count as plainly visible. A
    Karnopp valve is taken for the one of the same S and J that rests at every scan: beside it a stop may show nothing.
    """
    if get(name).noise is not None:
        return np.inf
    rest = [(n, v) for n, v in setting.effects if get(n).noise is None and n != name]
    lag = setting.plant.second_time_constant_s
    if lag and not any(n == "extra-lag" for n, _ in setting.effects):
        rest.append(("extra-lag", {"second_time_constant_s": lag}))
    if setting.law == "karnopp" and not any(n == "re-sticking" for n, _ in setting.effects):
        # It rests between the scans of its held command, however fast that moves.
        rest.append(("re-sticking", {"restick_speed": 1e9}))
    mine = dict(setting.effects)[name]
    found = find_range(loop)
    scanned = setting.controller.scan_s > 0.0

    def model_of(loop: Loop, effects: Sequence[tuple[str, dict]]) -> tuple[Model, np.ndarray]:
        spec = Spec(process=INTEGRATOR if setting.plant.integrating else FIRST_ORDER,
                    effects=tuple(_spelt(n, v) for n, v in effects), between="hold" if scanned else "corner",
                    substeps=1 if scanned else 8)
        model = Model(loop, spec, s_max=swing_of(loop, found), period_s=time_scale_s(loop, found))
        S, J = setting.S, setting.J
        values: dict[str, float] = {}
        for n, v in effects:
            effect, numbers = get(n), dict(v)
            if effect.setting:
                theta, S, J = effect.setting(v, S, J)
                numbers |= dict(zip((p.name for p in effect.parameters_for(model.context)), theta[:, 0], strict=True))
            values |= {f"{_spelt(n, v)}:{p.name}": float(numbers.get(p.name, p.neutral))
                       for p in effect.parameters_for(model.context)}
        # The loop starts at rest; the first recorded output may have moved the valve already.
        force = float(loop.output[0]) - OPERATING_POINT
        force = force if abs(force) <= 0.5 * (S + J) else float(np.sign(force)) * 0.5 * (S - J)
        values |= {"S": S, "J": J, "initial_residual_force": force / (0.5 * (S + J)),
                   "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s}
        return model, model.vector(values)

    full, at = model_of(loop, [*rest, (name, mine)])
    # (Where a stop holds the valve at once it started elsewhere: the record tells.)
    at = full.values(first_force(full, full.cube(at[:, None]), _FORCES)[0])[:, 0]
    without, there = model_of(replace(loop, process_value=full.evaluate(at).model), rest)
    there[:2] = at[:2]
    starts = there[:, None].repeat(len(_LAGS), axis=1)
    starts[3] *= _LAGS
    best = float(descend_model(without, first_force(without, without.cube(starts), _FORCES)[0]).costs[0])
    if best > VISIBLE**2 * sd**2 * without.shared.rows:
        best = min(best, one_run(without, np.random.default_rng(0))[1])
    return float(np.sqrt(best / without.shared.rows)) / sd


def runs_away(loop: Loop, sd: float, noise: float) -> bool:
    """Whether what is hidden in a loop makes it swing far more than it did, at a noise of that share of its swing."""
    return float(np.ptp(loop.process_value[loop.samples // 4:])) > _RUNAWAY * sd / noise


def _spelt(name: str, values: dict) -> str:
    """The name of a hidden effect as a model spells it: with its variant, or its tag."""
    if name == "measured-disturbance":
        return f"{name}:D1"
    return f"{name}@{values['at']}" if "at" in values else name


def sized(name: str, rng, s: Setting, T: float, clean, sd: float) -> dict:
    """Parameters of a hidden effect: large enough to show at this noise, small enough to be physical.

    `T` is the plant's time scale in seconds.
    """
    u = rng.uniform
    length = s.duration_s
    v = clean.position
    speeds = np.abs(np.diff(clean.output)) / s.step_s
    speeds = speeds[speeds > 1e-9]
    sign = float(rng.choice([-1.0, 1.0]))
    swing = float(np.ptp(clean.process_value[clean.samples // 4:]))
    at = str(rng.choice(["output", "load"]))
    # What comes in at the load is in % of travel.
    moved = swing if at == "output" else swing / abs(s.plant.gain)
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
        "slew-limit": lambda: {"rate": s.J / (T * u(0.3, 1.0))},
        "valve-characteristic": lambda: {"log_rangeability": sign * u(2.5, 4.5)},
        "gain-nonlinearity": lambda: {"curvature": sign * u(0.25, 0.5) / (0.5 * swing)},
        "extra-lag": lambda: {"second_time_constant_s": T * u(0.3, 0.8)},
        "sinusoidal-disturbance": lambda: {"period_s": T * u(3.0, 11.0), "amplitude": swing * u(0.05, 0.12),
                                           "phase": u(-3.0, 3.0)},
        "step-disturbance": lambda: {"time_s": length * u(0.25, 0.75), "size": sign * moved * u(0.1, 0.3), "at": at},
        "ramp-disturbance": lambda: {"start_s": length * u(0.1, 0.5), "rate": sign * moved * u(0.3, 0.6) / length,
                                     "at": at},
        "narrow-band-disturbance": lambda: {"period_s": T * u(1.5, 6.0), "coherence_cycles": u(2.0, 6.0),
                                            "amplitude": swing * u(0.05, 0.1)},
        "random-walk-disturbance": lambda: {"innovation_sd": sd * u(0.6, 1.5)},
        "coloured-noise": lambda: {"root": u(0.6, 0.9), "innovation_sd": sd},
        "measured-disturbance": lambda: {"lag_s": T * u(0.1, 1.0), "dead_time_s": T * u(0.0, 0.5),
                                         "gain": swing * u(0.05, 0.15)},
        "direction-dependent-lag": lambda: {"closing_ratio": float(np.exp(sign * u(0.35, 0.9)))},
        "gain-drift": lambda: {"drift": (u(-45.0, -20.0) if sign < 0 else u(25.0, 80.0)) * 1000 / length},
        "dead-time-drift": lambda: {"drift": (u(-80.0, -50.0) if sign < 0 else u(60.0, 150.0)) * 1000 / length},
        "inverse-response": lambda: {"zero_s": T * u(0.2, 0.5), "lag_s": T * u(0.2, 0.5)},
        "underdamped-process": lambda: {"natural_period_s": T * u(2.5, 5.0), "damping": u(0.25, 0.6)},
        "measurement-limit": lambda: {"upper": float(np.quantile(clean.process_value, u(0.85, 0.95)))},
        "measurement-filter": lambda: {"time_constant_s": T * u(0.2, 0.5)},
        "positioner": lambda: {"integral_rate": 1.0 / (T * u(0.7, 3.0))},
        "backlash": lambda: {"play": s.S * u(0.1, 0.4)},
        "leak": lambda: {"leak": 1e3 / (T * u(20.0, 40.0))},
        "stiction-change": lambda: {"stickband_change": (c := u(-1.0, -0.5) if sign < 0 else u(0.4, 0.8)) * s.S,
                                    "jump_change": c * s.J, "time_s": length * u(0.3, 0.7)},
        "load-noise": lambda: {"root": u(0.7, 0.95), "innovation_sd": 20.0 * sd / abs(s.plant.gain)},
        "random-load-steps": lambda: {"interval_s": length / u(6.0, 12.0),
                                      "size": moved * u(0.2, 0.4) / abs(s.plant.gain)},
    }[name]()


FIRST, EQUIVALENT, MISSED = "first", "equivalent", "missed"


def verdict(row: dict) -> str:
    """FIRST where the hidden effect was named before any other, EQUIVALENT where as an equivalent of that, or MISSED.

    What else is true of the loop may be named before: the lag of a second-order plant, coloured noise, the inertia of a
    Karnopp valve. Of a pair both must be named, in any order. A clean loop must have nothing named but that.
    """
    hidden, found = names_of(row["effect"]), list(row["found"])
    true = {"coloured-noise"} if row["colour"] else set()
    true |= {"extra-lag"} if row["bed"] == "second order" else set()
    inert = row["kind"] == "karnopp"
    true |= PHYSICAL if inert else set()
    if not hidden:
        return MISSED if set(found) - true else FIRST
    # An inertial valve that overshoots or rests is both at once.
    same = {name: PHYSICAL if inert and name in PHYSICAL else {name} for name in hidden}
    named = [name for name in found if name not in true or name in set().union(*same.values())]
    others = set(row["equivalent"])
    if all(s & set(named[:len(hidden)]) for s in same.values()):
        return FIRST
    if len(named) <= len(hidden) and all(s & (set(named) | others) for s in same.values()):
        return EQUIVALENT
    return MISSED


def right(row: dict) -> bool:
    """Whether what is hidden in a loop was found first or as an equivalent of what was."""
    return verdict(row) != MISSED


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
    "direction-dependent-lag": (1, MOVES, {"closing_ratio": 2.0}),
    "gain-drift": (1, MOVES, {"drift": -35.0}),
    "dead-time-drift": (1, MOVES, {"drift": 90.0}),
    "inverse-response": (1, MOVES, {"zero_s": 3.0, "lag_s": 2.5}),
    "underdamped-process": (1, MOVES, {"natural_period_s": 24.0, "damping": 0.4}),
    "measurement-limit": (1, MOVES, {"upper": 53.5}),
    "measurement-filter": (1, MOVES, {"time_constant_s": 4.0}),
    "backlash": (1, MOVES, {"play": 1.0}),
    "leak": (4, MOVES, {"leak": 8.0}),
    "positioner": (1, MOVES, {"integral_rate": 0.1, "start": 0.5}),
    "stiction-change": (1, MOVES, {"stickband_change": 2.4, "jump_change": 1.5, "time_s": 400.0}),
    "load-noise": (1, MOVES, {"root": 0.7, "innovation_sd": 0.5}),
    "random-load-steps": (1, MOVES, {"interval_s": 90.0, "size": 1.5}),
}


def small(*names: str, seed: int = 21, **more) -> tuple[Setting, object]:
    """The setting and record of a small loop with the effects of SMALL, or with none; `more` replaces settings."""
    plant, moves = (SMALL[names[0]][:2] if names else (1, MOVES))
    noise = 0.0 if "coloured-noise" in names else NOISE
    setting = Setting(PLANTS[plant][0], replace(PLANTS[plant][1], scan_s=1.0), S=4.0, J=2.5, duration_s=float(SAMPLES),
                      setpoint_moves=moves, noise_sd=noise, effects=tuple((n, dict(SMALL[n][2])) for n in names))
    setting = replace(setting, **more)
    return setting, simulate(setting, seed=seed).loop
