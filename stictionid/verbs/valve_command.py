"""Command that the valve of a record follows: the output as recorded, or as its controller's law computed it.

A historian rounds or thins what it stores, and the valve got the full output. A coarse output card rounds what the
valve gets.
A law that the rounded output obeys gives its digits back (process/controller_law.py). The base model is then searched
under both commands and completed with noise, because only y can tell them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..fit.adequacy import said_rounding
from ..fit.context import Run
from ..fit.noise.completion import Refit, complete_model, place_slips
from ..fit.starts.intersample import surely_moves
from ..model.spec import Spec
from ..numerics.archived import LINES
from ..process.controller_law import controller_law, follows_in_full
from ..process.controller_words import steps_in_words, steps_of, words_of
from ..process.rounded import command_sd, is_coarse, step_of, thinned_output, unknown_step
from ..record.controller import FINE, FULL, LEFT, REBUILT, ROUNDED, SEEN_ROUNDED, Controller
from ..record.loop import Finding, Loop
from ..record.preconditions import swing_of
from ..record.study import Estimate

# Error of the rebuilt output, as a share of that of the rounded one, up to which y can tell which the valve followed.
_GIVES_BACK = 0.5
# Least stickband that is looked for, as a share of the largest that the swing of the output allows. Unit: 1.
_LEAST = 0.05
_SOURCE = "Astrom and Hagglund 1995 (digital PID)"


def command_of(piece: Loop, near: slice, run_of: Callable[[Loop], Run],
               alike: float) -> tuple[Loop, Controller | None, tuple[Finding, ...]]:
    """The record with the command that its valve follows, the controller's law, and what was found in words.

    The samples `near` are searched. The rounded command must explain y better by more than `alike`, a difference of
    BIC: few valves get their command rounded, and most historians round.
    """
    # A moving output obeys a law of the samples in pieces, with a wrong gain.
    law = None if surely_moves(piece) else controller_law(piece)
    if law is None:
        return piece, None, ()
    def searched(loop: Loop) -> Run:
        return run_of(loop.cut(near.start, near.stop) if near.stop - near.start < loop.samples else loop)

    here = searched(piece)
    if not is_coarse(here.loop, _LEAST * swing_of(here.loop, here.found)):
        use = "OP is used as recorded, with all the digits that it needs"
        return piece, law.controller, (_said(piece, law.controller, use, FINE),)
    full = follows_in_full(piece, law)
    thin = thinned_output(piece)
    lines = thin is not None and thin.way == LINES
    # No controller draws the straight lines of a historian, so no valve followed them.
    gain = 0.0 if lines else full_over_rounded(searched(full), here)
    rebuilt = gain > -alike
    # A command that the law knows hardly better than the record does makes slips early or late by chance, too.
    told = not lines and law.command_sd <= _GIVES_BACK * command_sd(piece)
    found = replace(law.controller, rebuilt=rebuilt, seen_by_valve=ROUNDED if told and not rebuilt else FULL)
    used = full if rebuilt else replace(piece, followed=ROUNDED) if told else piece
    proof = ("the recorded one has the straight lines of a historian" if lines else
             "the record can't tell from the rounded one" if abs(gain) <= alike else f"BIC {abs(gain):.0f} better")
    use = (f"OP is rebuilt from this law, and the valve follows the full output ({proof})" if rebuilt else
           f"the valve follows the rounded output ({proof}): OP is used as recorded" if told else
           "PV is recorded too coarsely for it to give back the digits of OP, which is used as recorded")
    code = REBUILT if rebuilt else SEEN_ROUNDED
    return used, found, (_said(piece, found, use, code, step=step_of(piece.output[piece.used]), delta_bic=gain),)


def full_over_rounded(full: Run, rounded: Run) -> float:
    """BIC by which the full command explains y better than the one recorded in steps; below 0 where it does worse."""
    return _complete_fit(full).gain_over(_complete_fit(rounded))


def _complete_fit(run: Run) -> Refit:
    fit = run.fit(Spec(law=run.law, fixed=dict(run.options.fixed)))
    return place_slips(complete_model(fit.model, fit.values, None, run.rng, descent=True), other_valves=True)


def rounding_left(loop: Loop, found: Estimate) -> tuple[Finding, ...]:
    """The warning on an output whose rounding was not undone, where it may move the valve."""
    if not is_coarse(loop, found.S):
        return ()
    return (Finding(LEFT, "warning", said_rounding(loop),
                    {"step": unknown_step(loop), "J_known": found.J_known}, (), "Widrow and Kollar 2008"),)


def _said(loop: Loop, controller: Controller, use: str, code: str, **evidence: float) -> Finding:
    """The finding on the steps of a record, on its controller, and on the use of the output."""
    u, y = loop.unit("output", "%"), loop.unit("process_value")
    steps = steps_in_words(steps_of(loop), u, y)
    return Finding(code, "info", f"{f'recorded {steps}; ' if steps else ''}the controller is a "
                   f"{words_of(controller, u, y)}: {use}", {"residual": controller.residual, **evidence}, (), _SOURCE)
