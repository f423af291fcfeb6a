"""Results as frozen dataclasses and their JSON form: oscillation, estimate, verdict, steps, candidates, study.

Field names are those of the contract's JSON. Numbers are written at full precision; a number that does not exist or
is not finite is null. Files of older schemas load; newer ones are refused.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from ..errors import DataError
from .as_json.built import built
from .as_json.shape import folded, is_shaped, left_out
from .controller import Controller, Steps
from .evidence import Check, Evidence
from .loop import Finding
from .planned_test import PlannedTest
from .rhythm import Rhythm
from .swing import Severity, Swing
from .tree import Equivalent, TreeNode
from .unexplained import Unexplained

# First words of the reason of a model that is not adequate because a noise carries what it leaves. Studies of versions
# before `carried_by` name that noise nowhere else.
BUT_FOR = "explained but for"
EXTRAPOLATES = "held-out-extrapolates"
SCHEMA = "stictionid.study/1"
VALVE_CHANGED = "valve-changed"
_SCHEMA_NUMBER = 1


@dataclass(frozen=True, slots=True)
class Cycle:
    """One whole oscillation: start and length in seconds, peak-to-peak swing of the controller output."""

    start_s: float
    period_s: float
    u_swing: float


@dataclass(frozen=True, slots=True)
class Range:
    """Oscillation of a record: period (Eq. 20, the longest cycle), S_max (Eq. 21), and the cycles behind them.

    `reference` says what the deviation was taken from ("setpoint" or "mean of y"), or that the cycles were counted by
    the "turning points of the output"; `reason` is one sentence.
    """

    oscillating: bool
    period_s: float | None
    period_median_s: float | None
    s_max: float | None
    cycles: tuple[Cycle, ...]
    reason: str
    unit: str = "%"
    reference: str = "setpoint"
    reversals: int = 0


@dataclass(frozen=True, slots=True)
class CreatedBy:
    """Versions and seed behind a study."""

    version: str
    seed: int
    python: str
    numpy: str
    numba: str


@dataclass(frozen=True, slots=True)
class DataRecord:
    """Description of a study's data by which they are found, checked and read again."""

    file: str | None
    sha256: str | None
    columns: dict[str, str]
    units: dict[str, str]
    rows: int
    rows_used: int
    step_s: float
    start: str | None
    end: str | None
    findings: tuple[Finding, ...] = ()
    name: str = "loop"
    options: dict[str, Any] = field(default_factory=dict)
    steps: Steps | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on stiction: "stiction", "no stiction" or "undecided", with the reason and a confidence 0..1.

    `checks` are the comparisons that decided it from y; a measured position or a finding may overrule them.
    """

    stiction: str
    reason: str
    confidence: float = 0.0
    evidence: Evidence = field(default_factory=Evidence)
    checks: tuple[Check, ...] = field(default=(), kw_only=True, metadata=left_out())


@dataclass(frozen=True, slots=True)
class PositionEstimate:
    """S and J read from a measured valve position, with the error of that fit in the unit of the position.

    `rmse_proportional` is the error of a position in proportion to the output, as that of a valve without friction.
    `shows_stiction` is true where the difference is more than the resolution of the position could make.
    """

    S: float
    J: float
    rmse: float
    gain: float | None = None
    offset: float | None = None
    rmse_proportional: float | None = None
    shows_stiction: bool | None = None


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviation of the break-away force from stroke to stroke, in `unit` and as a share of S (0 to 1)."""

    value: float
    unit: str
    share_of_S: float
    interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Estimate:
    """The last step's main numbers; S and J in `unit`, intervals at `interval_level`, null where unknown.

    The longest time constant comes first; `time_constants_intervals` has one interval, or null, for each. `J_known` is
    false where the record leaves more than half of J open: its interval, if there is one, is the answer. `S_pieces` and
    `J_pieces` are null where the interval has no gap. `scatter` is null where the law alone places every slip.
    """

    S: float
    J: float
    unit: str
    S_interval: tuple[float, float] | None
    J_interval: tuple[float, float] | None
    interval_level: float
    law: str
    gain: float
    time_constants_s: tuple[float, ...]
    dead_time_s: float
    integrating: bool
    initial_residual_force: float
    from_position: PositionEstimate | None = None
    gain_interval: tuple[float, float] | None = None
    time_constants_intervals: tuple[tuple[float, float] | None, ...] = ()
    dead_time_interval: tuple[float, float] | None = None
    J_known: bool = field(default=True, kw_only=True)
    S_pieces: tuple[tuple[float, float], ...] | None = field(default=None, kw_only=True)
    J_pieces: tuple[tuple[float, float], ...] | None = field(default=None, kw_only=True)
    scatter: Scatter | None = field(default=None, kw_only=True)


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """One fitted number; `effect` is null for the base model (valve law and process)."""

    effect: str | None
    name: str
    value: float
    unit: str
    interval: tuple[float, float] | None = None
    at_bound: bool = False
    identifiable: bool = True
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Distance of model and measurement in the unit of y: `rmse` is the free run, `rmse_one_step` the innovations.

    `noise_sd` is the irreducible noise, one number for all steps of a study (fit/adequacy.py). `rmse_path` is the error
    of the free run whose slips PV helped to place, `slips_moved` the share of slips that it moved or added (0 to 1);
    both are null where the law alone places them. `landing_sd` is the error that unknown digits of OP, or its unknown
    moves between samples, make where the stem lands; null where OP is known. Held-out errors are null where no block
    could be held out, and where the model extrapolates.
    """

    rmse: float
    rmse_holdout: float | None = None
    rmse_one_step: float | None = None
    rmse_one_step_holdout: float | None = None
    noise_sd: float | None = None
    fit_percent: float | None = None
    bic: float | None = None
    rmse_path: float | None = None
    slips_moved: float | None = None
    landing_sd: float | None = None

    @property
    def unavoidable(self) -> float | None:
        """Least free-run error of a true model: that of the irreducible noise and of what is unknown of OP."""
        return None if self.noise_sd is None else math.hypot(self.noise_sd, self.landing_sd or 0.0)

    @property
    def best(self) -> float:
        """Free-run error with slips where PV placed them, where it did: what "adequate" is judged by."""
        return self.rmse if self.rmse_path is None else self.rmse_path


@dataclass(frozen=True, slots=True)
class Restarts:
    """Number of independent searches, and how many of them ended in the best optimum found."""

    runs: int
    agree: int


@dataclass(frozen=True, slots=True)
class Step:
    """One stage of a study: the model so far, its parameters and its errors.

    `model` is the full description from which the model runs again without a search (model/restore.py). `variant`
    says where an added disturbance enters ("output" or "load"), or which tag it is. `supported` is the answer on an
    effect that was added by hand; null where a search added it, or the record can't tell.
    """

    added: str | None
    effects: tuple[str, ...]
    parameters: tuple[ParameterValue, ...]
    error: ErrorSummary
    restarts: Restarts
    supported: bool | None = field(default=None, kw_only=True)
    findings: tuple[Finding, ...] = ()
    model: dict[str, Any] = field(default_factory=dict)
    variant: str = ""

    @property
    def extrapolates(self) -> bool:
        """True where the model leaves the range of y on held-out blocks so far that no held-out error is stated."""
        return any(f.code == EXTRAPOLATES for f in self.findings)


@dataclass(frozen=True, slots=True)
class LawResult:
    """One law of `--law all`."""

    law: str
    S: float
    J: float
    rmse_holdout: float | None
    rmse: float | None = None


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect of the catalogue added to the model and refitted: its gain, and the decision to accept it or not.

    `gain_beyond_noise` and `delta_bic` are the BIC of the best model that holds the effect over the best one without
    it. With an accepted effect the one-step error falls in `blocks_better` of the `blocks` held out of the fit; null
    where none could be held out. `rejected_because` is empty for an effect of the model. `variant` says where a
    disturbance enters ("output" or "load"), or which tag it is.
    """

    effect: str
    accepted: bool
    rmse: float | None
    rmse_holdout: float | None
    rmse_one_step_holdout: float | None
    error_drop_percent: float | None
    one_step_drop_percent: float | None
    blocks_better: int | None = field(default=None, kw_only=True)
    blocks: int | None = field(default=None, kw_only=True)
    delta_bic: float | None
    gain_beyond_noise: float | None = field(default=None, kw_only=True)
    equivalent_to: tuple[str, ...] = ()
    detectable_from: str | None = None
    rejected_because: str = field(default="", kw_only=True)
    parameters: tuple[ParameterValue, ...] = ()
    statement: str = ""
    variant: str = ""


@dataclass(frozen=True, slots=True)
class CostMap:
    """Error over a grid of S (rows) and J (columns), the rest held: the one that the fit of `step` made small.

    `step` is the index of the step whose model it maps (None in files of older versions, which did not write it).
    """

    S: tuple[float, ...]
    J: tuple[float, ...]
    rmse: tuple[tuple[float | None, ...], ...]
    searched: tuple[tuple[float, float], ...] = ()
    step: int | None = None


@dataclass(frozen=True, slots=True)
class Study:
    """Result of one identification, step by step; the only object that commands hand to each other.

    `tree` holds every model that the search tried; it is empty in a study of an older version. `evaluations` counts
    the search's cost evaluations. `unasked` lists what the budget left untried. `equivalents` explain the record alike.
    `missing_reason` says in words what is missing, and `unexplained` holds the shape of it. `carried_by` is the noise
    that alone keeps the model from being adequate: "coloured noise", "a random walk", "a narrow band" or "a drift";
    else it is empty. `rhythm` is set by a batch, which compares the loops of a plant. `planned_test` is the manual test
    that would settle an open answer. `with_intervals` is false for a study that was asked for without them.
    """

    created_by: CreatedBy
    data: DataRecord
    range: Range
    verdict: Verdict
    estimate: Estimate | None
    steps: tuple[Step, ...] = ()
    laws: tuple[LawResult, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    tree: tuple[TreeNode, ...] = field(default=(), kw_only=True)
    evaluations: int | None = field(default=None, kw_only=True)
    unasked: tuple[str, ...] = field(default=(), kw_only=True)
    equivalents: tuple[Equivalent, ...] = field(default=(), kw_only=True)
    missing_reason: str = field(default="", kw_only=True)
    missing: tuple[str, ...] = ()
    adequate: bool | None = None
    adequate_reason: str = ""
    carried_by: str = field(default="", kw_only=True)
    cost_map: CostMap | None = None
    command: str = ""
    severity: Severity | None = None
    unexplained: Unexplained | None = field(default=None, kw_only=True)
    rhythm: Rhythm | None = field(default=None, kw_only=True)
    swing: Swing | None = field(default=None, kw_only=True)
    controller: Controller | None = field(default=None, kw_only=True)
    planned_test: PlannedTest | None = field(default=None, kw_only=True)
    with_intervals: bool = field(default=True, kw_only=True)
    schema: str = SCHEMA

    @property
    def completed(self) -> bool:
        """True for a model that is not adequate only because a noise carries what it leaves."""
        return self.adequate is False and bool(self.carried_by)

    @property
    def interval_caution(self) -> str:
        """Caution about the intervals of a model that is not adequate, as a sentence; empty for any other one."""
        if self.adequate is not False or self.completed or not self.estimate or self.estimate.S_interval is None:
            return ""
        return "The intervals hold only as far as this model does; what it misses may move S and J out of them."


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """A result as plain JSON types: dataclasses to dicts, tuples and arrays to lists, non-finite numbers to None."""
    if is_dataclass(value) and not isinstance(value, type):
        if is_shaped(type(value)):
            return plain(folded(value))
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        if set(map(type, value)) == {float}:
            return [v if math.isfinite(v) else None for v in value]  # in one pass, as below
        return [plain(v) for v in value]
    if isinstance(value, bool) or value is None or isinstance(value, (str, int)):
        return value
    if hasattr(value, "tolist"):
        values = value.tolist()
        if getattr(value, "ndim", 0) == 1 and value.dtype.kind == "f":
            # Records have millions of numbers: one pass without a call for each.
            return [v if math.isfinite(v) else None for v in values]
        return plain(values)
    number = float(value)
    return number if math.isfinite(number) else None


def to_json(value: Any) -> str:
    """A result as JSON text that ends in a newline; `schema` comes first in a study."""
    content = plain(value)
    if isinstance(content, dict) and "schema" in content:
        content = {"schema": content.pop("schema"), **content}
    # A file name that is not valid UTF-8 reaches Python as lone surrogates; as JSON escapes they are legal text.
    return _indented(content, "\n").encode("utf-8", "backslashreplace").decode("utf-8") + "\n"


def _indented(content: Any, line: str) -> str:
    """JSON text with one line for every item, except lists of numbers and words; `line` begins a line.

    `json.dumps` with an indent writes one line for every number, item by item in Python.
    """
    inner = line + " "
    if isinstance(content, dict) and content:
        items = (f"{_ENCODER.encode(key)}: {_indented(value, inner)}" for key, value in content.items())
        return "{" + inner + ("," + inner).join(items) + line + "}"
    if isinstance(content, list) and any(isinstance(value, (dict, list)) for value in content):
        return "[" + inner + ("," + inner).join(_indented(value, inner) for value in content) + line + "]"
    return _ENCODER.encode(content)


def study_from_json(text: str) -> Study:
    """The study written in `text`; DataError where it is no study, is damaged, or has a newer schema."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        at = f" from line {error.lineno}, column {error.colno} on" if isinstance(error, json.JSONDecodeError) else ""
        raise DataError(f"not a study, or one that was cut off: it is no JSON{at}",
                        "give a file written by stictionid identify -o") from None
    schema = content.get("schema") if isinstance(content, dict) else None
    if not isinstance(schema, str) or not schema.startswith("stictionid.study/"):
        raise DataError("not a study: it has no schema 'stictionid.study/…'",
                        "give a file written by stictionid identify -o")
    number = schema.rpartition("/")[2]
    if not number.isdigit() or int(number) > _SCHEMA_NUMBER:
        raise DataError(f"the study has schema {schema}, newer than {SCHEMA} that this version reads",
                        "update stictionid")
    try:
        study = built(Study, content)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise DataError(f"the study is damaged: {error}", "run stictionid identify again") from None
    if "carried_by" in content or study.adequate is not False:
        return study
    _, found, said = study.adequate_reason.partition(f"{BUT_FOR} ")
    return replace(study, carried_by=said.partition(":")[0]) if found else study
