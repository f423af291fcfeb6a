"""Contract of a physical effect: the hooks of each kind, so that a new effect is one new file.

An effect is one file in `effects/` with a constant `EFFECT`. It fills the hooks of its kind and leaves the others:

* F (friction): `friction(table, theta, command_step_s, held)` returns the friction table (ROWS, P) with other
  numbers; a change with time follows `profile(time_s)`. It transforms no signal, so every law gets it.
* T (transform): `run(signal, y, theta, part_s, state, out)`, a kernel over (rows, P), or `dynamics(dynamics, theta)`,
  which returns other process dynamics: other lags, or one more linear element of unit gain (process/state_space.py).
  The kernel updates `state` (states, P), so that the closed-loop simulator can call it one row at a time. `y` is the
  process value as its distance from its centre, at the time when a move of the signal arrives. It is (rows, P), or
  (rows, 1) for effects that don't follow y. For `timed` effects it is the time in seconds when the move arrives.
* L (linear): `columns(theta, context)` returns columns (n, P) for the least squares; their sizes are linear. In the
  variant "load", or of an effect that acts `ahead`, they enter through the process.
* N (noise): `noise` names the noise model; it cannot lower a free-run error.

`theta` is (k, P): one row for each searched parameter, in order. At every parameter's neutral value the effect
vanishes, so models are nested. `contains` names simpler effects that are a case of this one: they are preferred where
they explain as much. `guess(context)` returns starting points (g, k) for the search. `report` gives the public
parameters of a fit, where they are not the searched ones and the sizes of the columns. `disturb(values, time_s, rng)`
is the disturbance that the effect adds in a simulation. `setting` maps public values, S and J to searched parameters
(k, 1), S and J, where the two differ. `plant(values, dynamics)` does the same for the process of a simulation.

`counted(y)` are the samples (n,) of a record that count beside an effect of the measurement, and `measured(y, values)`
is what a simulation records for y. An effect that leaves every sample counted is not asked for.

`shown(context)` is twice the log-likelihood that the best guess of an effect with a tag gains on the residual of a
model without it. Of many tags the best few enter a search.
`picked_from(context)` is the number of alternatives, such as tags times lags, out of which a fit picks the best one.
The gain that names the effect grows with twice its logarithm.

An effect that is `asked` BY_HAND is left to `add` and `identify --with`: u and y can't tell it from its equivalents.
`known(option)` is the effect with the number that stands behind a colon in its name, "backlash:1.5".
Effects that users write in plain numpy (`written.py`, `plain.py`) are subclasses, which replace `transformed` and
`mover`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ...errors import UsageError
from ...numerics.jit import kernel
from ...numerics.parameters import Parameter
from ...process.linear import Dynamics
from ...typing import BoolArray, FloatArray


class Place(Enum):
    """Place of an effect on the way from command to measurement; effects combine in this order."""

    FRICTION = 1
    STEM = 2
    TRIM = 3
    PROCESS = 4
    DISTURBANCE = 5
    NOISE = 6


@dataclass(frozen=True, slots=True)
class Record:
    """Place of a segment in its whole record: start and length in seconds, gaps included, and the centre of y."""

    start_s: float
    length_s: float
    centre: float


@dataclass(frozen=True, slots=True)
class Context:
    """Record and grid that an effect may use. The rows of `command` are fine steps, those of the rest are samples.

    `guide` (n,) is the process value of the model. An effect that depends on y must not see the measured one, or it
    would predict y from itself. `record` is set where this is one segment of a record with gaps. `held` is true where
    the command is constant from one of its values to the next.
    """

    command: FloatArray
    process_value: FloatArray
    setpoint: FloatArray | None
    step_s: float
    period_s: float
    s_max: float = 1.0
    extras: dict[str, FloatArray] = field(default_factory=dict)
    residual: FloatArray | None = None
    guide: FloatArray | None = None
    record: Record | None = None
    held: bool = True

    @property
    def command_step_s(self) -> float:
        """Seconds between two values of the command."""
        return self.step_s * self.process_value.size / self.command.size

    @property
    def length_s(self) -> float:
        """Seconds of the whole record, gaps included."""
        return self.process_value.size * self.step_s if self.record is None else self.record.length_s

    @property
    def start_s(self) -> float:
        """Seconds from the start of the whole record to the first sample."""
        return 0.0 if self.record is None else self.record.start_s

    @property
    def time_s(self) -> FloatArray:
        """Seconds at the samples since the start of the whole record, (n,)."""
        return self.start_s + np.arange(self.process_value.size, dtype=np.float64) * self.step_s

    @property
    def centre(self) -> float:
        """Mean setpoint of the whole record, or mean of y without one; the reference point of gains."""
        if self.record is not None:
            return self.record.centre
        return float(np.mean(self.process_value if self.setpoint is None else self.setpoint))


@kernel
def _later(signal: FloatArray, repeat: int, late: FloatArray, out: FloatArray) -> None:
    """Fill out (n*repeat, P) with a signal (n,) as it is `late` (P,) samples after the middle of every part.

    The middle is taken because under a held command the mean of y over the part counts. The end value is held.
    """
    last = signal.size - 1
    for k in range(out.shape[0]):
        now = (k + 0.5) / repeat
        for p in range(late.size):
            at = min(max(now + late[p], 0.0), float(last))
            i = min(int(at), max(last - 1, 0))
            out[k, p] = signal[i] + (at - i) * (signal[min(i + 1, last)] - signal[i])


Friction = Callable[[FloatArray, FloatArray, float, bool], FloatArray]
Values = Mapping[str, float]
# Disturbance of an effect in a simulation: at the output (n,), at the load (n,), and tags that the record then holds.
Disturbance = tuple[FloatArray, FloatArray, dict[str, FloatArray]]
# Position of a simulation after an effect, from position, distance of y from its centre, time and length of a part.
Mover = Callable[[float, float, float, float], float]


@dataclass(frozen=True, slots=True)
class Scales:
    """Scales of a simulated loop without the effect: S and J in %, lag and length in s, swing of y, travel in %.

    `speed` is the median speed of the command where it moves, in %/s; `noise` the deviation of its noise, `top` the
    highest y after its first quarter.
    """

    S: float
    J: float
    lag_s: float
    length_s: float
    swing: float
    lowest: float
    highest: float
    speed: float
    noise: float
    top: float


# Traces in a residual, and the questions that find them (comparison/): error by time with a shifted level or not, by
# what the valve does, by direction, output, process value, part of the cycle, after setpoint moves; coloured errors,
# errors that follow the valve, and a line at the oscillation's own period or another one. Then the answer to a valve
# move (fit/noise/unexplained.py): for a while less than modelled, more, or both in turn, or more and more with time.
TRACES = ("level", "stretch", "stick", "slip", "slide", "direction", "output", "value", "cycle", "setpoint", "colour",
          "valve", "own line", "line", "dip", "bump", "swing",
          "drift")
# Axes over which a residual shows an effect: time since a reversal of the valve by direction, travel, process value,
# time, part of the effect's own cycle, and period of a spectrum.
AXES = ("direction", "travel", "y", "time", "phase", "spectrum")
# Whether `diagnose` tries an effect, or a user has to name it.
DIAGNOSE, BY_HAND = "diagnose", "by hand"


def known_value(name: str, option: str, parameter: Parameter) -> float:
    """The number behind the colon of an effect's name; UsageError where it is none or out of range."""
    try:
        value = float(option)
    except ValueError:
        value = np.nan
    if not parameter.low <= value <= parameter.high:
        raise UsageError(f"{name}:{option} is no {parameter.meaning.partition(',')[0]} from {parameter.low:g} to "
                         f"{parameter.high:g} {parameter.unit}", f"write for example {name}:1.5")
    return value


MOST_TIMES = 100
"""Most times in the name of an effect."""


def times_in(name: str) -> FloatArray:
    """The times (k,) in seconds behind the colon of an effect's name; ValueError where one is no number."""
    return np.unique([float(t) for t in filter(None, name.partition(":")[2].split("+"))])


def name_at(name: str, times_s: FloatArray) -> str:
    """The name of an effect with times (k,) in seconds behind its colon."""
    return f"{name}:" + "+".join(f"{t:.9g}" for t in times_s.tolist())


@dataclass(frozen=True, slots=True)
class Natural:
    """Conversion of S and J to the two numbers that slips identify under an effect on the friction, and back.

    `numbers(S, J, theta, context)` returns the swing of the command between two opposite slips and the slip (P,), both
    in %. The timing of the slips fixes the swing to a part in a thousand. `valve(swing, slip, theta, context)` returns
    the S and J of such a valve. `longest(theta)` (P,) is the factor by which a slip may be longer for its swing than
    without the effect.
    """

    numbers: Callable[[FloatArray, FloatArray, FloatArray, Context], tuple[FloatArray, FloatArray]]
    valve: Callable[[FloatArray, FloatArray, FloatArray, Context], tuple[FloatArray, FloatArray]]
    longest: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Seen:
    """The numbers that slips identify in place of an effect's own: `limits` of each, and `offset(S, J)` (k, P).

    An own number is the number that slips identify plus its offset.
    """

    limits: Callable[[Context], tuple[Parameter, ...]]
    offset: Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Effect:
    """One physical effect: name, parameters, equation, source, and hooks.

    `parameters` are all public ones; `searched` names those that join the search (None: all), the others are linear
    or follow from them. `run_means` replaces `run` for a signal of means over the parts of a sample, as under a command
    that moves within them. The effect then finds the instant inside the part. `fine` asks for parts of a sample even
    under a held command; `follows_y` is true where the kernel uses y. `reach` is the factor by which the upper limit of
    S grows with this effect. `slides` is true where only a valve that slides shows it. `scan(shares, context)`
    spreads shares (5 + k, P) over where valves, their processes and the effect lie, for a search of its own
    (fit/starts/own_scan.py). Such an effect is asked for where nothing else explains a record. `by_itself` says that
    `identify` may add the effect without a look at its rivals. `natural` are the numbers in which such a valve is
    searched, `seen` those in which the effect is. `leaves` names the traces of the effect in a residual (see TRACES),
    with its rank among those that leave the same one. `settled_by` is a test that shows the effect, and `told_apart`
    one for each effect that looks alike. `noun` names the effect for a reader at the plant, `sentence` says its size,
    `action` what to do, `brief` the answer in a few words. In them {name} stands for a parameter with its unit,
    {one+other} for a sum, {tag} for the tag. Of the parts in [above {lower}|below {upper}] only those stay whose
    numbers the record fixes. `seen_over`, one of AXES, is the axis over which a residual shows the effect. `of_record`
    names the parameters that belong to one record, such as the phase of a wave; those of the plant hold in every
    record. `ahead` is true for a disturbance that enters ahead of the process at the times in its name, `at_once` for
    friction that changes at one time, its last parameter (row SINCE of the table, in seconds of the whole record).
    `visible` gives public values that plainly show in a simulated loop, the middle of
    those that tests find. The smallest size that shows is asked for at five values `tried_at` of the first searched
    parameter, stated for both parameters of a `two_sided` effect, under the public name that `known_as` gives. `file`
    and `sha256` are those of a user-written effect, and `slower` tells how many times longer a model takes with its
    function than with a kernel.
    """

    name: str
    kind: str
    place: Place
    summary: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...] = ()
    searched: tuple[str, ...] | None = None
    confused_with: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    fine: bool = False
    follows_y: bool = False
    timed: bool = False
    asked: str = DIAGNOSE
    reach: float = 1.0
    by_itself: bool = False
    slides: bool = False
    natural: Natural | None = None
    seen: Seen | None = None
    scan: Callable[[FloatArray, Context], FloatArray] | None = None
    states: int = 0
    limits: Callable[[Context], tuple[Parameter, ...]] | None = None
    friction: Friction | None = None
    profile: Callable[[FloatArray], FloatArray] | None = None
    run: Callable[..., None] | None = None
    run_means: Callable[..., None] | None = None
    start: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    dynamics: Callable[[Dynamics, FloatArray], Dynamics] | None = None
    plant: Callable[[Values, Dynamics], Dynamics] | None = None
    counted: Callable[[FloatArray], BoolArray] | None = None
    measured: Callable[..., float] | None = None
    known: Callable[[str], Effect] | None = None
    columns: Callable[[FloatArray, Context], tuple[FloatArray, ...]] | None = None
    noise: str | None = None
    guess: Callable[[Context], FloatArray] | None = None
    shown: Callable[[Context], float] | None = None
    picked_from: Callable[[Context], float] | None = None
    report: Callable[[Values, FloatArray, Values], dict[str, float]] | None = None
    disturb: Callable[[Values, FloatArray, np.random.Generator], Disturbance] | None = None
    setting: Callable[[Values, float, float], tuple[FloatArray, float, float]] | None = None
    visible: Callable[[Scales], Values] | None = None
    tried_at: Callable[[Context], FloatArray] | None = None
    two_sided: bool = False
    known_as: Mapping[str, str] = field(default_factory=dict)
    leaves: Mapping[str, int] = field(default_factory=dict)
    settled_by: str = ""
    told_apart: Mapping[str, str] = field(default_factory=dict)
    noun: str = ""
    sentence: str = ""
    brief: str = ""
    action: str = ""
    seen_over: str = "time"
    of_record: tuple[str, ...] = ()
    at_once: bool = False
    ahead: bool = False
    file: str = ""
    sha256: str = ""
    slower: float = 1.0

    @property
    def moves(self) -> bool:
        """True where the effect transforms the valve position."""
        return self.run is not None

    @property
    def drifts(self) -> bool:
        """True where the effect changes friction all along the record, not at one time."""
        return self.profile is not None and not self.at_once

    @property
    def asked_last(self) -> bool:
        """True for an effect with a search of its own, which takes longer than all others together."""
        return self.asked == DIAGNOSE and self.scan is not None

    def enters_ahead(self, option: str) -> bool:
        """True where the columns of the effect, with this variant, enter through the process."""
        return self.ahead or option == "load"

    def asked_for(self, process_value: FloatArray) -> bool:
        """True where a search tries the effect on a record with this y (n,)."""
        return self.asked == DIAGNOSE and (self.counted is None or not self.counted(process_value).all())

    def parameters_for(self, context: Context) -> tuple[Parameter, ...]:
        """The searched parameters with limits for this record."""
        if self.limits:
            return self.limits(context)
        return tuple(p for p in self.parameters if self.searched is None or p.name in self.searched)

    def public_values(self, searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
        """Public parameters by name from the searched ones, the sizes of the columns, and the values of the model."""
        if self.report:
            return self.report(searched, sizes, base)
        return {**searched, **dict(zip((p.name for p in self.parameters if p.name not in searched), sizes.tolist(),
                                       strict=False))}

    def _arriving(self, signal: FloatArray, context: Context, dead_time_s: FloatArray | None) -> FloatArray:
        """Process value (rows, P or 1) at the time when each row of the signal arrives."""
        guide = (context.process_value if context.guide is None else context.guide) - context.centre
        repeat = signal.shape[0] // guide.size
        if self.timed:
            late = 0.0 if dead_time_s is None else np.asarray(dead_time_s, dtype=np.float64)
            at = context.start_s + np.arange(signal.shape[0], dtype=np.float64) * (context.step_s / repeat)
            return np.asarray(at[:, None] + np.broadcast_to(late, signal.shape[1]), dtype=np.float64)
        if not self.follows_y:
            return np.zeros((signal.shape[0], 1))
        if dead_time_s is None:
            return np.repeat(guide, repeat)[:, None].repeat(signal.shape[1], axis=1)
        out = np.empty(signal.shape)
        _later(guide, repeat, np.asarray(dead_time_s, dtype=np.float64) / context.step_s, out)
        return out

    def transformed(self, signal: FloatArray, theta: FloatArray, context: Context,
                    dead_time_s: FloatArray | None = None) -> FloatArray:
        """The whole signal (rows, P) through this effect's kernel, from its own start; moves arrive `dead_time_s` (P,)
        later."""
        assert self.run is not None
        y = self._arriving(signal, context, dead_time_s)
        theta = np.ascontiguousarray(theta)
        state = self.start(signal, theta) if self.start else np.zeros((max(self.states, 1), signal.shape[1]))
        out = np.empty_like(signal)
        part_s = context.step_s * context.process_value.size / signal.shape[0]
        run = self.run if context.held or self.run_means is None else self.run_means
        run(np.ascontiguousarray(signal), y, theta, part_s, state, out)
        return out

    def mover(self, start: float, theta: FloatArray, step_s: float) -> Mover:
        """This effect's kernel for a simulation that advances a position part by part, from rest at `start`.

        `step_s` is the sampling time of the record that the simulation makes.
        """
        assert self.run is not None
        kernel, first = self.run, np.full((1, 1), start)
        state = self.start(first, theta) if self.start else np.zeros((max(self.states, 1), 1))

        def move(position: float, y: float, time_s: float, part_s: float) -> float:
            out = np.empty((1, 1))
            kernel(np.full((1, 1), position), np.array([[time_s if self.timed else y]]), theta, part_s, state, out)
            return float(out[0, 0])

        return move
