"""Steps of a record and the law of its controller, as a study keeps them and as people read them."""

from __future__ import annotations

from itertools import pairwise

from ..record.controller import Controller, Steps
from ..record.loop import Loop
from .controller_law import MOST, controller_law
from .rounded import step_of


def steps_of(loop: Loop) -> Steps:
    """Steps in which output and process value of a record were recorded."""
    return Steps(*(step_of(signal[loop.used]) or None for signal in (loop.output, loop.process_value)))


def as_read(loop: Loop) -> Controller | None:
    """The controller of a record that was only read; None where no law is found.

    A law that breaks with no gap is left to `identify`: it may be that of an output that moves between samples.
    """
    law = controller_law(loop.longest_segment())
    if law is None or any(a.stop == b.start and a.stop - a.start < MOST for a, b in pairwise(law.stretches)):
        return None
    return law.controller


def words_of(controller: Controller, output: str, process_value: str) -> str:
    """The law of a controller with the intervals of its numbers, for signals with these units."""
    def number(name: str, value: float | None, unit: str) -> str:
        low, high = controller.intervals[name]
        if value is None:
            return ""
        span = "" if f"{low:.4g}" == f"{high:.4g}" else f" ({low:.4g} to {high:.4g})"
        return f", {name.removesuffix('_s').replace('_', ' ')} {value:.4g}{unit}{span}"

    times = (("integral_time_s", controller.integral_time_s), ("derivative_time_s", controller.derivative_time_s))
    gain = number("gain", controller.gain, f" {output}/{process_value}" if process_value else "")
    return controller.kind + gain + "".join(number(name, value, " s") for name, value in times if value is not None)


def steps_in_words(steps: Steps, output: str, process_value: str) -> str:
    """The steps of both signals; empty where none shows."""
    known = [f"{name} in steps of {step:.4g}{f' {unit}' if unit else ''}" for name, step, unit in
             (("OP", steps.output, output), ("PV", steps.process_value, process_value)) if step]
    return " and ".join(known)
