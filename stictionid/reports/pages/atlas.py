"""Atlas of the effects: the trace of each on valve, process value and residual of one standard loop.

The loop is simulated with the effect. A plain model, with the true valve and process but without the effect, runs on
its command; what it leaves is the trace. Sizes are those that plainly show (model/visible.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...effects import get
from ...effects.contract import Effect
from ...model.closed_loop import PRESETS, Setting, simulate, with_stiction
from ...model.segments import bind_model
from ...model.spec import FIRST_ORDER, INTEGRATOR, Evaluated, Spec
from ...model.visible import visible_values
from ...record.loop import Loop
from ...record.oscillation import find_range
from .. import wording
from ..pictures.measures import thin
from ..pictures.picture import Line, Panel, Picture, Rule

# The standard loop: S and J in %, noise in the unit of y, length and scan in s. Setpoint moves, in s and the unit of y,
# keep the valve going where an effect ends the cycle.
_S, _J, _NOISE, _LENGTH_S, _SCAN_S, _SEED = 4.0, 2.0, 0.05, 600.0, 1.0, 1
_MOVES = ((0.0, 5.0), (150.0, -8.0), (300.0, 8.0), (420.0, -6.0), (520.0, 6.0))
# Seconds that the picture shows, and axes of effects that only the whole record shows.
_SHOWN_S = 240.0
_WHOLE = ("time", "travel", "y")
_BINS, _FORCES = 200, 41


def standard_loop(effect: Effect) -> Setting:
    """The loop in which an effect is shown: one lag, or an integrator where the effect needs one."""
    name = "itptd" if "integrator" in effect.needs else "foptd"
    base = with_stiction(PRESETS[name], _S, _J)
    return replace(base, controller=replace(base.controller, scan_s=_SCAN_S), noise_sd=_NOISE, duration_s=_LENGTH_S,
                   setpoint_moves=_MOVES)


def atlas_picture(name: str) -> Picture:
    """Valve, process value and residual of the standard loop with one effect; UsageError for an unknown effect."""
    effect = get(name)
    setting = standard_loop(effect)
    values = visible_values(name, setting)
    loop = simulate(replace(setting, effects=((name, dict(values)),)), seed=_SEED).loop
    plain = _plain_model(loop, setting)
    from_s = 0.0 if effect.seen_over in _WHOLE or effect.noise else loop.samples * loop.step_s - _SHOWN_S
    shown = loop.time_s >= from_s
    t, known = loop.time_s[shown], plain.counted > 0
    model, residual = (np.where(known, x, np.nan)[shown] for x in (plain.model, plain.residual))
    assert loop.position is not None

    def line(label: str, role: str, values: np.ndarray) -> Line:
        return Line(label, role, *thin(t, values, _BINS))

    size = ", ".join(f"{key} {wording.number(value)}" for key, value in values.items())
    spread = float(np.sqrt(np.nanmean(residual**2)))
    return Picture(f"atlas-{name}", f"{name}: {effect.summary}",
                   f"A model without the effect leaves a residual of {wording.number(spread)} %, the noise is "
                   f"{wording.number(_NOISE)} %.", f"Standard loop (S {_S:g} %, J {_J:g} %) with {size}.",
                   (Panel("", "OP, valve, %", (line("OP", "op", loop.output[shown]),
                                               line("valve", "position", loop.position[shown]),
                                               line("plain valve", "guide", plain.position[shown])), height=0.8),
                    Panel("", "PV, %", (line("PV", "pv", loop.process_value[shown]),
                                        line("plain model", "model", model)), height=0.8),
                    Panel("time, s", "residual, %", (line("residual", "residual", residual),),
                          rules=(Rule("y", 0.0),), height=0.5)), wide=True)


def _plain_model(loop: Loop, setting: Setting) -> Evaluated:
    """The true loop without its effect on the record's command; gain, offset and start are those of least squares."""
    plant = setting.plant
    spec = Spec(process=INTEGRATOR if plant.integrating else FIRST_ORDER, between="hold")
    found = find_range(loop)
    model = bind_model(loop, spec, s_max=found.s_max or 2.0 * setting.S, period_s=found.period_median_s or _SHOWN_S)
    values = model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": 0.0,
                           "time_constant_s": plant.time_constant_s, "dead_time_s": plant.dead_time_s})
    trial = values[:, None].repeat(_FORCES, axis=1)
    trial[model.forces[0]] = np.linspace(-0.99, 0.99, _FORCES)
    return model.evaluate(trial[:, int(np.argmin(model.costs_of(trial)))])


def atlas_words(name: str) -> tuple[str, ...]:
    """The effect in sentences: what it is, what it is mistaken for, what settles it, what to do."""
    effect = get(name)
    said = [wording.sentence(effect.summary)]
    alike = dict.fromkeys((*effect.told_apart, *effect.confused_with))
    said += [f"Mistaken for: {', '.join(alike)}."] if alike else []
    said += [f"What settles it: {effect.settled_by}."] if effect.settled_by else []
    if effect.action and "{" not in effect.action:
        said.append(effect.action)
    return tuple(said)
