"""The verbs as plain functions: data in, a new study out, with one thread of BLAS and messages for Python."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UsageError
from ..selection.policy import Policy, with_budget
from ..typing import Progress
from .arguments import checked, refuse
from .loop import Loop, loop_in_file, loop_of
from .messages import Shown, in_python, speaking_python
from .plots import is_own, loop_for
from .progress import teller
from .study import Study
from .threads import one_thread

if TYPE_CHECKING:
    import pandas as pd

    from ..comparison import Comparison as Compared
    from ..record.study import Study as StudyRecord

# Names of a known plant.
_PLANT = ("gain", "time_constant_s", "dead_time_s")
# Findings shown in a short text.
_SHOWN = 5


@speaking_python
@checked
@one_thread
def identify(loop: Loop | pd.DataFrame | str | os.PathLike[str], *, law: str | None = None,
             effects: Sequence[str] = (), method: str = "auto", base_only: bool = False, between: str = "auto",
             scan_s: float | None = None, plant: Mapping[str, float] | None = None, intervals: bool = True,
             seed: int = 0, budget: int | None = None, progress: Progress | None = None, test: str | None = None,
             op_limits: tuple[float, float] | None = None, pv_limits: tuple[float, float] | None = None) -> Study:
    """S, J, process, errors and verdict of a loop: a Loop, a DataFrame, or the path of a file.

    S and J are in % of travel, the gain of the process in the unit of PV per %, lags and dead time in s, errors in the
    unit of PV. `law` names a stiction law or "all", `effects` are put into the model from the start, `base_only` stops
    at the base model. `plant` holds what is known of the process: gain (unit of PV per %, of an integrator per s,
    too), time_constant_s and dead_time_s (s). `between` says what the output did between samples, `scan_s` is the scan
    of the controller in s. Without `intervals` the study has none and takes less time. `budget` is the largest number
    of cost evaluations. `test` "steps" reads a manual test. `op_limits` (% of travel) and `pv_limits` (unit of PV)
    bound the test that is planned. The same seed gives the same study. A record that can't tell gives a study with the
    verdict "undecided" and its reason.
    """
    from ..options import USUAL_SCAN_S, Options
    from ..verbs.identify import identify as run

    found = loop_of(loop)
    unknown = sorted(set(plant or {}) - set(_PLANT))
    if unknown:
        raise UsageError(f"the plant has no {unknown[0]!r}", "give " + ", ".join(_PLANT))
    named = (effects,) if isinstance(effects, str) else tuple(effects)
    options = Options(method, law, named, base_only, between, {k: float(v) for k, v in (plant or {}).items()}, seed,
                      command="stictionid.identify", scan_s=USUAL_SCAN_S if scan_s is None else scan_s, test=test,
                      intervals=intervals)
    return _study(run(found.record, options=options, policy=_policy(budget), progress=teller(progress)), found,
                  op_limits=op_limits, pv_limits=pv_limits)


@speaking_python
@checked
@one_thread
def diagnose(study: Study, loop: Loop | pd.DataFrame | str | os.PathLike[str] | None = None, *,
             apply: bool = False, everything: bool = False, bootstrap: int = 0, seed: int = 0, jobs: int = 1,
             budget: int | None = None, progress: Progress | None = None) -> Study:
    """The study with ranked candidates and the effect to add next; `apply` adds all that the search finds.

    `everything` asks for the whole catalogue even where the model is adequate. `bootstrap` replicates give the named
    effect a p-value. `jobs` processes share the fits. Raises DataError for an abstained study.
    """
    from ..verbs.diagnose import diagnose as run

    found = loop_for(study.record, loop, study.loop)
    return _study(run(found.record, study.record, everything=everything, apply=apply, seed=seed, jobs=jobs,
                      bootstrap=bootstrap, policy=_policy(budget), progress=teller(progress)), found)


@speaking_python
@checked
@one_thread
def add(study: Study, effect: str, loop: Loop | pd.DataFrame | str | os.PathLike[str] | None = None, *,
        prune: bool = False, seed: int = 0, progress: Progress | None = None) -> Study:
    """The study with one more step: the model refitted with an effect ("step-disturbance@load" names a variant).

    The noise is completed anew, and parts that a search put in go where they are needless. `prune` also leaves out
    effects added by hand that are superfluous now. Raises UsageError for an unknown effect or one that the model has
    already, DataError for an abstained study.
    """
    from ..verbs.add import add as run

    found = loop_for(study.record, loop, study.loop)
    return _study(run(found.record, study.record, effect, seed=seed, prune=prune, progress=teller(progress)), found)


@speaking_python
@checked
@one_thread
def remove(study: Study, effect: str, loop: Loop | pd.DataFrame | str | os.PathLike[str] | None = None, *,
           seed: int = 0, progress: Progress | None = None) -> Study:
    """The study without an effect: the steps that came after it are refitted, and the verdict is that of what is left.

    A finding of the last step says what the effect was worth. Raises UsageError for an effect that the model does not
    have, DataError for an abstained study.
    """
    from ..verbs.remove import remove as run

    found = loop_for(study.record, loop, study.loop)
    return _study(run(found.record, study.record, effect, seed=seed, progress=teller(progress)), found)


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """A model held against a record: its errors, and findings that say where it fails. `record` holds all arrays."""

    record: Compared = field(repr=False)

    @property
    def adequate(self) -> bool:
        """True where the model holds on this record."""
        return self.record.adequate

    @property
    def findings(self) -> pd.DataFrame:
        """Findings, the most serious first."""
        from .tables import findings

        return findings(self.record.findings)

    def _lines(self) -> list[str]:
        r = self.record
        what = "another record" if r.validates else "its own record"
        some = [f"{f.severity}: {in_python(f.statement)}"[:200] for f in r.findings[:_SHOWN]]
        more = len(r.findings) - len(some)
        return [f"Comparison with {what}: the model is {'' if r.adequate else 'not '}adequate",
                in_python(r.adequate_reason),
                f"free-run error {r.error.rmse:.4g}, one step {r.error.rmse_one_step:.4g}, of y(k) = y(k-1) "
                f"{r.error.persistence:.4g}", *some, *([f"{more} more findings"] if more else [])]


@speaking_python
@checked
@one_thread
def compare(study: Study, loop: Loop | pd.DataFrame | str | os.PathLike[str] | None = None) -> Comparison:
    """The study's last model against its own record; another loop validates it there.

    On another record the valve and the process are held, start state and bias are refitted.
    """
    from ..comparison import compare as run

    found = study.loop if loop is None else loop_of(loop)
    if found is None:
        found = loop_in_file(study.record)
    if is_own(study.record, found, study.loop):
        return Comparison(run(found.record, study.record))
    return Comparison(run(None if study.loop is None else study.loop.record, study.record, found.record))


@speaking_python
@one_thread
def report(study: Study | Sequence[Study], path: str | os.PathLike[str],
           loop: Loop | pd.DataFrame | str | os.PathLike[str] | None = None, *, figures: str = "svg",
           force: bool = False, progress: Progress | None = None) -> Path:
    """Write a report of one study, or of several, and return its place; .html, .md with its pictures, or .json.

    The data are those that the study still has, `loop`, or the study's file; without them the report has tables only.
    """
    from ..reports.pages.write import write_report
    from ..reports.pictures.curves import Case, curves, gather

    if not isinstance(study, Sequence) or isinstance(study, str):
        refuse("study", study)
    studies = [study] if isinstance(study, Study) else list(study)
    for name, value in (*(("study", each) for each in studies), ("figures", figures), ("path", path)):
        refuse(name, value)
    if loop is not None and len(studies) > 1:
        raise UsageError(f"one loop and {len(studies)} studies do not go together", "report them one by one")
    cases = []
    for each in studies:
        own: Loop | None = each.loop if loop is None else loop_for(each.record, loop, each.loop)
        cases.append(gather(each.record) if own is None else
                     Case(each.record, own.record, tuple(curves(each.record, own.record))))
    write_report(cases, Path(path), figures=figures, force=force, progress=teller(progress))
    return Path(path)


def _study(record: StudyRecord, loop: Loop, **limits: tuple[float, float] | None) -> Study:
    """A study with its loop, and with the test that would settle it."""
    from ..verdict.planned_test import with_plan

    return Study(with_plan(record, loop.record, **limits), loop)


def _policy(budget: int | None) -> Policy | None:
    return None if budget is None else with_budget(Policy(), budget)
