"""The picture of a valve bench: for each test u and u_v against time, and u_v against u.

It only draws: every line exists as numbers in the outcomes. Same outcomes give the same bytes (no dates, no random
ids). Only this file and figures.py load matplotlib, and only when a picture is made.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from ...model.valve_bench import BenchOutcome
from . import palette

SVG_KIND = b"<?xml"
# Size of one test's row and resolution. Unit: inches, dots per inch.
_WIDE, _ROW, _TOP, _DPI = 9.2, 1.75, 0.6, 110


def valve_figure(outcomes: Sequence[BenchOutcome], *, kind: str, title: str) -> bytes:
    """The picture as a file of `kind` "png" or "svg"; one row for each outcome, `title` above."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: Any = {"font.family": "DejaVu Sans", "font.size": 8.0, "svg.hashsalt": "stictionid",
                     "axes.titlesize": 8.5, "text.usetex": False, "text.parse_math": False,
                     "axes.spines.top": False, "axes.spines.right": False}
    command, position = palette.LOOKS["op"], palette.LOOKS["position"]
    with rc_context(settings):
        figure = Figure(figsize=(_WIDE, _TOP + _ROW * len(outcomes)), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(outcomes), 2, squeeze=False, width_ratios=[3.2, 1.0])
        for (trend, loop), outcome in zip(grid, outcomes, strict=True):
            trend.plot(outcome.time_s, outcome.command, color=command.light, linewidth=1.0, label="u (command)")
            trend.plot(outcome.time_s, outcome.position, color=position.light, linewidth=1.2, linestyle="--",
                       label="u_v (position)")
            failed = [e.what for e in outcome.expectations if not e.holds]
            verdict = "fails: " + "; ".join(failed) if failed else "all expectations hold"
            trend.set_title(f"{outcome.test}: {verdict}", loc="left")
            trend.set_ylabel("%")
            loop.plot(outcome.command, outcome.position, color=position.light, linewidth=0.9)
            ends = [float(outcome.command.min()), float(outcome.command.max())]
            loop.plot(ends, ends, color=palette.LOOKS["rule"].light, linewidth=0.8)
            loop.set_ylabel("u_v / %")
        grid[-1, 0].set_xlabel("time / s")
        grid[-1, 1].set_xlabel("u / %")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="upper right", ncols=2, frameon=False)
        figure.suptitle("".join(c for c in title if c.isprintable()), x=0.01, ha="left")
        out = io.BytesIO()
        figure.savefig(out, format=kind, metadata={"Date": None} if kind == "svg" else {"Software": None})
    return out.getvalue()
