"""Agreement of S and J between several records of one loop, and their drift with time.

Each record is identified on its own. Each side of an interval becomes a standard deviation (90 % are 1.645 of them).
The common value has the smallest sum of squared distances (chi-square). That sum says whether the records scatter more
than their intervals allow. A straight line through the records is the drift; where they scatter more about it, its
interval is widened by as much (Birge's ratio). Records that abstain or whose valve does not stick have no S and J to
compare and are listed with the reason.

Where windows of one record differ, or some of them give no S and J, a change of the valve is asked of the whole
record. It is said where it gains 10 BIC more than a drift.

Wrong where all records lack the same effect: they then agree in the same error. Source: chi-square of a weighted mean
and Birge's ratio as in the averages of the Particle Data Group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import PurePath

import numpy as np

from ..effects import built_in
from ..errors import CannotTell, StictionidError, UsageError
from ..fit.intervals.assemble import INTERVAL_LEVEL
from ..options import Options
from ..record.loop import Loop
from ..record.study import CreatedBy, Study
from ..selection.policy import Policy
from ..system.plurals import counted as plural
from ..typing import FloatArray, Progress
from .add import add
from .identify import identify as run_identify
from .identify import made_by
from .support import CODES
from .valve_changes import CHANGE, Change, change_of

SCHEMA = "stictionid.agreement/1"
MOST_WINDOWS = 200
# Chance of scattering as much or more below which records of one valve count as different. S and J are tested.
DIFFERENT = 0.01
# Smallest standard deviation of a record, as a share of the value. docs/details.md, section 11: with nothing missing S
# comes back within 0.5 %, J mostly within 3 %, whatever the interval of a long record says.
_FINEST = {"S": 0.005, "J": 0.03}
# Two-sided quantile of the normal distribution that belongs to INTERVAL_LEVEL. Unit: standard deviations.
_QUANTILE = 1.6448536269514722
_FEWEST_FOR_DRIFT = 3
# The rival of a change.
_DRIFT = built_in(lambda effect: effect.drifts)
# Units of time for a slope by the span they suit, in seconds.
_UNITS = ((90 * 86400.0, 30 * 86400.0, "30 days"), (2 * 86400.0, 86400.0, "day"), (0.0, 3600.0, "hour"))

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RecordResult:
    """One record: its label and file, the time of its middle (seconds after the first record's), and its results.

    `counted` records enter spread and drift; `reason` says why the others do not. `at_s` is None without a common
    clock.
    """

    label: str
    file: str | None
    middle: str | None
    at_s: float | None
    verdict: str
    confidence: float
    S: float | None
    J: float | None
    S_interval: Span | None
    J_interval: Span | None
    period_s: float | None
    counted: bool
    reason: str
    code: str = ""


@dataclass(frozen=True, slots=True)
class Spread:
    """Spread of S or J between records: extremes, standard deviation, and whether the intervals allow it.

    `common` is the value that fits all records best, `overlap` the intersection of all intervals (None: empty).
    `chance` is the probability that records of one unchanged valve scatter as much or more. It is None where fewer than
    two records have an interval.
    """

    name: str
    unit: str
    records: int
    low: float
    high: float
    sd: float
    common: float | None
    overlap: Span | None
    chi_square: float | None
    freedom: int | None
    chance: float | None
    agree: bool | None
    statement: str


@dataclass(frozen=True, slots=True)
class Drift:
    """The straight line through S or J over time: slope with interval, and the change over the whole span.

    `per` is the unit of time ("30 days", "day", "hour", or "record" where the records have no common clock). `drifts`
    says whether the interval of the slope excludes 0. `start` is the line's value at the first record.
    """

    name: str
    unit: str
    per: str
    slope: float
    slope_interval: Span
    start: float
    change: float
    change_interval: Span
    drifts: bool
    statement: str


@dataclass(frozen=True, slots=True)
class Agreement:
    """Comparison of several records of one loop; `agree` is None where fewer than two can be compared."""

    created_by: CreatedBy
    records: tuple[RecordResult, ...]
    spreads: tuple[Spread, ...]
    drifts: tuple[Drift, ...]
    agree: bool | None
    statement: str
    unit: str
    interval_level: float = INTERVAL_LEVEL
    command: str = ""
    changes: tuple[Change, ...] = ()
    schema: str = SCHEMA


def windows(loop: Loop, count: int) -> tuple[Loop, ...]:
    """The record cut into `count` windows of equal length, in order; UsageError where it is too short for them."""
    _check_count(count)
    if loop.samples < count:
        raise UsageError(f"--windows {count} of a record of {loop.samples} samples leaves nothing in a window",
                         "give fewer windows")
    edges = np.linspace(0, loop.samples, count + 1).astype(int).tolist()
    return tuple(loop.cut(a, b) for a, b in pairwise(edges))


def _check_count(count: int) -> None:
    if not 1 <= count <= MOST_WINDOWS:
        raise UsageError(f"--windows {count} is outside 1 to {MOST_WINDOWS}", "give 3 or 4")


def compare_records(loops: Sequence[Loop], *, count: int = 1, options: Options | None = None,
                    unreadable: Sequence[tuple[str, str]] = (), progress: Progress | None = None) -> Agreement:
    """Identify every loop, cut into `count` windows each, and compare the results.

    `unreadable` are files that could not be read, with the reason: they are listed. Raises UsageError where there are
    fewer than two records, or their outputs have different units.
    """
    options = options or Options()
    tell = progress or (lambda text, share: None)
    _check_count(count)
    if len(loops) * count + len(unreadable) < 2:
        raise UsageError("one record has nothing to agree with", "give several files, or --windows 3")
    _refuse_twins(loops)
    units = sorted({loop.unit("output", "%") for loop in loops})
    if len(units) > 1:
        raise UsageError(f"the controller outputs have different units: {', '.join(units)}",
                         "give --span-op LO,HI so that all are in %")
    pieces = [(loop, i, piece, at) for loop in loops for i, (piece, at) in
              enumerate(zip(windows(loop, count), _middles(loop, count), strict=True), 1)]
    common = len(loops) == 1 or all(_seconds(loop.origin.start) is not None for loop in loops)
    if common:
        pieces.sort(key=lambda p: p[3])
    first = pieces[0][3] if pieces else 0.0
    records = []
    for k, (loop, i, piece, at) in enumerate(pieces):
        label = _label(loop, loops, i, count)
        tell(f"record {k + 1} of {len(pieces)}: {label}", k / len(pieces))
        study = run_identify(piece, options=options)
        records.append(_record(label, study, _stamp(loop, at), at - first if common else None))
    records += [RecordResult(name, name, None, None, "undecided", 0.0, None, None, None, None, None, False, why,
                             "unreadable") for name, why in unreadable]
    changes = []
    for loop in loops if count > 1 else ():
        mine = [r for r, piece in zip(records, pieces, strict=False) if piece[0] is loop]
        if _differ(mine):
            tell(f"looking for a change of the valve in {loop.origin.file or loop.name}", 1.0)
            changes += [c for c in [_find_change(loop, options)] if c is not None]
    return agreement(records, units[0] if units else "%", made_by(options), options.command, changes)


def _differ(records: Sequence[RecordResult]) -> bool:
    """True where windows of one record differ beyond their intervals, or where some give no S and J."""
    counted = [r for r in records if r.counted]
    spreads = [_spread(name, "", counted) for name in ("S", "J")] if counted else []
    return len(counted) < len(records) or any(s.agree is False for s in spreads)


def _find_change(loop: Loop, options: Options) -> Change | None:
    """The change within a record, asked for beside its base; None where there is none, or a drift explains as much."""
    try:
        study = run_identify(loop, options=options)
        if study.estimate is None:
            return None
        changed = add(loop, study, CHANGE, seed=options.seed)
        found = change_of(loop, changed)
        if found is None:
            return None
        drifts = add(loop, study, _DRIFT, seed=options.seed)
    except StictionidError:
        return None
    return found if _gain(changed, CHANGE) >= _gain(drifts, _DRIFT) + Policy().alike else None


def _gain(study: Study, name: str) -> float:
    """BIC that an effect added by hand gains beyond noise."""
    return next((float(f.evidence["gain_beyond_noise"]) for step in study.steps if step.added == name
                 for f in step.findings if f.code in CODES), 0.0)


def agreement(records: Sequence[RecordResult], unit: str, created_by: CreatedBy, command: str = "",
              changes: Sequence[Change] = ()) -> Agreement:
    """Spread, drift and statement of records that are already identified; `changes` were found within them."""
    counted = [r for r in records if r.counted]
    spreads = tuple(_spread(name, unit, counted) for name in ("S", "J")) if counted else ()
    drifts = tuple(d for name in ("S", "J") if (d := _drift(name, unit, counted)) is not None)
    known = [s.agree for s in spreads if s.agree is not None]
    agree = all(known) if known else None
    said = "; ".join([_said(records, counted, spreads, () if changes else drifts), *(
        c.statement + (f" ({PurePath(c.file).name})" if c.file and len({r.file for r in records}) > 1 else "")
        for c in changes)])
    return Agreement(created_by, tuple(records), spreads, drifts, agree, said, unit, command=command,
                     changes=tuple(changes))


def cannot(found: Agreement) -> CannotTell | None:
    """The reason why nothing could be compared; None where at least two records were."""
    if found.agree is not None:
        return None
    return CannotTell(found.statement, "give more or longer records; stictionid identify tells more of each",
                      code="too-few-records")


def _said(records: Sequence[RecordResult], counted: Sequence[RecordResult], spreads: Sequence[Spread],
          drifts: Sequence[Drift]) -> str:
    tally = {word: sum(r.verdict == word for r in records) for word in ("stiction", "no stiction", "undecided")}
    said = (f"{plural(len(records), 'record')}: " + ", ".join(f"{n} {word}" for word, n in tally.items() if n)
            + f"; {len(counted)} of them give S and J")
    known = [s for s in spreads if s.agree is not None]
    if not known:
        return said + "; two records with intervals are needed for a comparison"
    bad = [s.name for s in known if not s.agree]
    if not bad:
        said += "; they agree within their intervals"
    else:
        said += f"; they differ in {' and '.join(bad)} by more than their intervals allow"
    return "; ".join([said, *(d.statement for d in drifts if d.drifts)])


def _record(label: str, study: Study, middle: str | None, at_s: float | None) -> RecordResult:
    e, v = study.estimate, study.verdict
    counted = e is not None and v.stiction != "no stiction"
    why = v.reason if counted or e is None else f"no stiction, so there is no S to compare; {v.reason}"
    return RecordResult(label, study.data.file, middle, at_s, v.stiction, v.confidence, e.S if e else None,
                        e.J if e else None, e.S_interval if e else None, e.J_interval if e else None,
                        study.range.period_median_s, counted, why, v.evidence.code or "")


def _known(name: str, records: Sequence[RecordResult]) -> tuple[list[RecordResult], FloatArray, FloatArray]:
    """Records with an interval of S or J, the values (k,), and the standard deviation (2, k) below and above each."""
    have = [r for r in records if getattr(r, f"{name}_interval") is not None]
    values = np.array([getattr(r, name) for r in have])
    ends = np.array([getattr(r, f"{name}_interval") for r in have]).reshape(-1, 2)
    sides = np.abs(ends.T - values) / _QUANTILE
    return have, values, np.maximum(sides, np.maximum(_FINEST[name] * np.abs(values), 1e-12))


def _chi_square(values: FloatArray, sides: FloatArray, line: FloatArray | float) -> float:
    off = np.asarray(line) - values
    return float(np.sum((off / np.where(off < 0, sides[0], sides[1])) ** 2))


def _common(values: FloatArray, sides: FloatArray) -> float:
    """The value with the smallest chi-square, by bisection: chi-square is convex."""
    low, high = float(values.min()), float(values.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        off = middle - values
        if float(np.sum(off / np.where(off < 0, sides[0], sides[1]) ** 2)) > 0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def _spread(name: str, unit: str, records: Sequence[RecordResult]) -> Spread:
    from scipy.special import chdtrc

    everything = np.array([getattr(r, name) for r in records])
    low, high = float(everything.min()), float(everything.max())
    sd = float(np.std(everything, ddof=1)) if everything.size > 1 else 0.0
    have, values, sides = _known(name, records)
    said = f"{name} lies between {low:.4g} and {high:.4g} {unit} in {plural(everything.size, 'record')}"
    if len(have) < 2:
        return Spread(name, unit, everything.size, low, high, sd, None, None, None, None, None, None,
                      said + "; fewer than two have an interval, so nothing can be said about agreement")
    common = _common(values, sides)
    chi, freedom = _chi_square(values, sides, common), len(have) - 1
    chance = float(chdtrc(freedom, chi))
    ends = np.array([getattr(r, f"{name}_interval") for r in have])
    inside = float(ends[:, 0].max()), float(ends[:, 1].min())
    overlap = inside if inside[0] <= inside[1] else None
    agree = chance >= DIFFERENT
    often = (f"{100 * chance:.2g} % of repeats of one unchanged valve" if chance >= 1e-4
             else "almost no repeat of one unchanged valve")
    said += (f", {common:.4g} {unit} goes best with all; a scatter of this size (chi-square {chi:.3g}, {freedom} "
             f"degree{'s' if freedom > 1 else ''} of freedom) comes in {often}: "
             + ("they agree within their intervals" if agree else
                "the valve changed between them, or something is missing from the model"))
    return Spread(name, unit, everything.size, low, high, sd, common, overlap, chi, freedom, chance, agree, said)


def _drift(name: str, unit: str, records: Sequence[RecordResult]) -> Drift | None:
    """Weighted straight line through the records that have an interval; None for fewer than three of them."""
    from scipy.special import stdtrit

    have, values, sides = _known(name, records)
    clock = all(r.at_s is not None for r in have)
    when = np.array([r.at_s if clock else k for k, r in enumerate(have)], dtype=float)
    if len(have) < _FEWEST_FOR_DRIFT or not np.ptp(when) > 0:
        return None
    span = float(np.ptp(when))
    size, per = next((s, word) for limit, s, word in _UNITS if span >= limit) if clock else (1.0, "record")
    t = (when - when.min()) / size
    line = np.full(t.size, _common(values, sides))
    for _ in range(20):  # the line decides which side of an interval counts
        weight = 1.0 / np.where(line < values, sides[0], sides[1])
        design = np.stack([np.ones_like(t), t], axis=1) * weight[:, None]
        (start, slope), *_ = np.linalg.lstsq(design, values * weight, rcond=None)
        line = start + slope * t
    error = float(np.sqrt(np.linalg.inv(design.T @ design)[1, 1]))
    freedom = t.size - 2
    birge = float(np.sqrt(_chi_square(values, sides, line) / freedom))
    # A scatter that the intervals do not explain is itself estimated from few records: Student's quantile.
    reach = error * (_QUANTILE if birge <= 1.0 else birge * float(stdtrit(freedom, 0.5 + 0.5 * INTERVAL_LEVEL)))
    low, high = float(slope - reach), float(slope + reach)
    long, drifts = span / size, not low <= 0.0 <= high
    change = float(slope) * long
    said = (f"{name} {'rises' if change > 0 else 'falls'} by {abs(slope):.3g} {unit} per {per} ({low:.3g} to {high:.3g}"
            f"), {change:+.3g} {unit} from the first record to the last" if drifts else
            f"{name} shows no drift: {slope:+.3g} {unit} per {per} ({low:.3g} to {high:.3g})")
    return Drift(name, unit, per, float(slope), (low, high), float(start), change, (low * long, high * long), drifts,
                 said)


def _label(loop: Loop, loops: Sequence[Loop], window: int, count: int) -> str:
    """The label of a record: its file (with its path where two have the same name) or loop, and its window."""
    if len(loops) == 1 and count > 1:
        return f"window {window}"
    file = loop.origin.file
    name = PurePath(file).name if file else loop.name
    if file and sum(PurePath(one.origin.file or "").name == name for one in loops) > 1:
        name = file
    return f"{name} window {window}" if count > 1 else name


def _refuse_twins(loops: Sequence[Loop]) -> None:
    """UsageError where two records hold the same bytes: a record always agrees with itself."""
    seen: dict[str, str] = {}
    for loop in loops:
        key, name = loop.origin.sha256, loop.origin.file or loop.name
        if key is not None and key in seen:
            raise UsageError(f"{seen[key]} and {name} hold the same bytes: a record agrees with itself",
                             "give other records, or --windows 3 for one")
        if key is not None:
            seen[key] = name


def _seconds(stamp: str | None) -> float | None:
    """A stamp in seconds since 1970; None where it is none of a calendar."""
    try:
        moment = datetime.fromisoformat(stamp or "")
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _middles(loop: Loop, count: int) -> list[float]:
    """Time of the middle of each window, in seconds since 1970, or since the first sample without a calendar."""
    edges = np.linspace(0, loop.samples, count + 1)
    stamps = [_seconds(s) for s in loop.origin.segment_starts]
    begins = list(loop.starts)
    if len(stamps) != len(begins) or any(s is None for s in stamps):
        stamps, begins = [_seconds(loop.origin.start) or 0.0], [0]
    found = []
    for middle in 0.5 * (edges[:-1] + edges[1:]):
        k = int(np.searchsorted(begins, middle, side="right")) - 1
        found.append(float(stamps[k] or 0.0) + float(middle - begins[k]) * loop.step_s)
    return found


def _stamp(loop: Loop, at: float) -> str | None:
    """The time of a record as text."""
    if _seconds(loop.origin.start) is None:
        return f"{at:.6g} s"
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="seconds").removesuffix("+00:00")
