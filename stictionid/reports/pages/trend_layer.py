"""The interactive trend of a page: a record's signals as data for the page's script, and the controls around it.

The script (page.js) draws the signals on a canvas, thinned to the lowest and highest value of each pixel column, and
thins again on every zoom. Without script, and on paper, the static picture replaces it.
"""

from __future__ import annotations

import base64
import json
from datetime import datetime
from html import escape

import numpy as np

from ...model.spec import Curves
from ...record.loop import Loop
from ...typing import FloatArray
from ..pictures import measures, palette
from ..pictures.curves import Case
from ..pictures.study_pictures import axis_label, shading, unit_of

# Panels of the layer, by index: SP, PV and model above, OP and positions below.
_UPPER, _LOWER = 0, 1


def trend_layer(case: Case, loop: Loop, name: str) -> str:
    """The controls and the data of the trend of a study with its loop as HTML; `name` keeps its ids apart."""
    data = json.dumps(_layer_data(case, loop), ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    # In JSON, < > & occur only inside strings, where their escapes mean the same; no tag can end the data block.
    data = data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    toggles = "".join(f'<label><input type="checkbox" checked value="{k}">{_swatch(role)}{escape(label)}</label>'
                      for k, (label, role, _, _, _) in enumerate(_signals(case, loop)))
    roles = {b.role for b in shading(case.study, loop, _last(case), 1.0)}
    keys = ('<span class="key"><i></i>model fails</span>' if "failing" in roles else "") \
        + ('<span class="key off"><i></i>not used</span>' if "unused" in roles else "")
    buttons = "".join(f'<button type="button" data-do="{do}">{text}</button>' for do, text in (
        ("in", "Zoom in"), ("out", "Zoom out"), ("left", "Earlier"), ("right", "Later"), ("all", "Whole record")))
    return (f'<div class="trend" id="{name}" hidden><fieldset class="bar"><legend>Show</legend>{toggles}{keys}'
            f'</fieldset><div class="bar">{buttons}</div>'
            f'<div class="plot" tabindex="0" role="group" aria-label="Trend, zoomable" aria-describedby="{name}-keys">'
            f'<canvas role="img" aria-label="Trends over time"></canvas></div>'
            f'<output aria-live="polite"></output><p class="keys" id="{name}-keys">Drag over a stretch to zoom in, '
            "double-click for the whole record. Keys: arrows move the cursor, + and - zoom, Page Up and Page Down "
            f'move the view, Home shows all.</p><script type="application/json">{data}</script></div>')


def _layer_data(case: Case, loop: Loop) -> dict[str, object]:
    """Data for the script: signals as base64 of little-endian float32 (n,), bands in s, names and looks."""
    signals = []
    for label, role, panel, unit, values in _signals(case, loop):
        look = palette.LOOKS[role]
        encoded = base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
        signals.append({"name": label, "role": role, "panel": panel, "unit": unit, "dash": list(look.dash),
                        "width": look.width, "data": encoded})
    bands = [{"from": b.start, "to": b.end, "role": b.role} for b in shading(case.study, loop, _last(case), 1.0)]
    return {"step": loop.step_s, "samples": loop.samples, "starts": list(loop.starts), "clock": _clock(case, loop),
            "panels": [{"label": axis_label("PV", loop, "process_value")},
                       {"label": axis_label("OP", loop, "output", "%")}],
            "signals": signals, "bands": bands}


def _last(case: Case) -> Curves | None:
    return case.curves[-1] if case.curves else None


def _signals(case: Case, loop: Loop) -> list[tuple[str, str, int, str, FloatArray]]:
    """Name, role, panel, unit and values (n,) of every signal present."""
    last = _last(case)
    pv, op = unit_of(loop, "process_value"), unit_of(loop, "output", "%")
    model, inferred = ((x if np.isfinite(x).any() else None for x in (last.model, last.position))
                       if last is not None else (None, None))
    every = (("SP", "sp", _UPPER, pv, loop.setpoint),
             ("PV", "pv", _UPPER, pv, measures.joined(loop, loop.process_value)), ("model", "model", _UPPER, pv, model),
             ("OP", "op", _LOWER, op, loop.output),
             ("measured position", "position", _LOWER, unit_of(loop, "position", "%"), loop.position),
             ("inferred position", "bound", _LOWER, op, inferred))
    return [(name, role, panel, unit, x) for name, role, panel, unit, x in every if x is not None]


def _clock(case: Case, loop: Loop) -> int | None:
    """Wall clock of the first sample in s since 1970 as the plant's clock showed it; None where unknown or gapped."""
    if len(loop.starts) > 1:
        return None
    try:
        start = datetime.fromisoformat(case.study.data.start or "").replace(tzinfo=None)
    except ValueError:
        return None
    return round((start - datetime(1970, 1, 1)).total_seconds())


def _swatch(role: str) -> str:
    return ('<svg class="pic" viewBox="0 0 30 10" aria-hidden="true" focusable="false">'
            f'<path class="r-{role}" d="M0 5h30"/></svg>')
