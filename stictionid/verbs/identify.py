"""The verb `identify`: from a record to S and J, or to the reason why the record does not determine them.

`identify` checks what the record must hold (record/preconditions.py) and finds period and S_max. It passes the record
(of a long one an excerpt) to a method (see methods/). It then adds the verdict, the comparison with a measured position
and the cost map. With the law "all" it does so for every law that can be searched and ranks them. Source:
docs/details.md, section 6.
"""

from __future__ import annotations

import platform
from dataclasses import replace

import numpy as np

from .. import methods as method_room
from .._version import __version__
from ..errors import CannotTell
from ..fit.adequacy import judge_adequacy, with_one_noise
from ..fit.context import Run, process_numbers
from ..fit.intervals.along_path import scatter_of
from ..fit.intervals.assemble import INTERVAL_LEVEL
from ..fit.noise.unexplained import judged_by
from ..fit.points.fitted import Fitted
from ..fit.study_steps import widen_to_equivalents, with_known_jump, with_stated_interval
from ..methods.contract import Method, Outcome
from ..methods.option_check import check_options
from ..options import ALL_LAWS, Options, searchable
from ..process.controller_words import steps_of
from ..process.rounded import measured_rows
from ..record.evidence import Evidence
from ..record.intervals import intervals_withheld, without_intervals
from ..record.loop import Finding, Loop
from ..record.oscillation import BY_TURNS, find_range
from ..record.preconditions import check, swing_of
from ..record.segments import chosen
from ..record.study import (
    CostMap,
    CreatedBy,
    DataRecord,
    Estimate,
    LawResult,
    PositionEstimate,
    Range,
    Step,
    Study,
    Verdict,
)
from ..selection.policy import Policy
from ..typing import Progress
from ..verdict import law_ranking
from ..verdict.from_position import from_position
from ..verdict.judge import ASK, UNANSWERED, cap_verdict, judge
from ..verdict.severity import with_controller
from ..verdict.swing import meaning_of
from .by_hand import with_carrier
from .long_records import excerpt, judged
from .manual_test import open_loop, stepped
from .valve_changes import with_change
from .valve_command import command_of, rounding_left

_MAP_S, _MAP_J = 41, 31
# Free-run error, in times the noise, from which a record of uneven turns is not judged, and the advice for it.
_FAR = 4.0
# Distance of S and J, as a share of S_max, within which a search has ended at the fit.
_NEAR = 0.02
_CLEARER = "export faster, or a stretch with setpoint moves"


def identify(loop: Loop, *, options: Options | None = None, policy: Policy | None = None,
             progress: Progress | None = None) -> Study:
    """S, J, process, errors and verdict of one loop as a study; an abstention is a study too, with its reason.

    Deterministic for a seed. `policy` holds the numbers of the search; None means the defaults. Raises UsageError for
    options that do not exist or do not apply to the method. Needs u and y; r is optional.
    """
    options = options or Options()
    check_options(options, policy)
    tell = progress or (lambda text, share: None)
    tell("looking for the oscillation", 0.02)
    method = method_room.get(options.method)
    if options.test is not None:
        loop = open_loop(loop)
    piece, notes = chosen(loop, restarts=method.restarts)
    options.check_record(piece)
    found = find_range(piece)
    notes += options.notes
    laws: tuple[LawResult, ...] = ()
    try:
        check(piece, found, by_hand=options.test is not None)
        if options.test is not None:
            found = stepped(piece, found)
        view, controller = excerpt(piece, found, options), None
        if "policy" in method.options and options.test is None:
            # The methods of the literature take the output as it stands, and in manual it is exact.
            piece, controller, said = command_of(
                piece, slice(0, piece.samples) if view is None else view.searched,
                lambda part: _run_of(part, found, replace(options, law=None) if options.law == ALL_LAWS else options,
                                     method, tell), (policy or Policy()).alike)
            notes = (*notes, *said)
        piece = measured_rows(piece)
        view = None if view is None else replace(view, whole=piece)
        near = piece if view is None else view.loop
        if options.law == ALL_LAWS:
            run, outcome, laws = _every_law(near, found, options, method, policy, tell)
        else:
            run = _run_of(near, found, options, method, tell)
            outcome = _outcome(method, run, policy)
    except CannotTell as reason:
        return abstained(loop, found, options, reason)
    if outcome.verdict is not None:
        return Study(made_by(options), data_record(loop, piece, notes), found, cap_verdict(outcome.verdict, loop), None,
                     command=options.command)
    near_fit = last = outcome.fits[-1]
    if view is not None:
        outcome, note = judged(view, _run_of(piece, found, run.options, method, tell), outcome)
        last, notes = outcome.fits[-1], (*notes, note)
    if intervals_withheld(outcome.steps) or not options.intervals:
        outcome = replace(outcome, steps=without_intervals(outcome.steps))
        last = replace(last, intervals={}, pieces={})
    outcome = replace(outcome, steps=with_one_noise(outcome.steps, piece))
    holds, why = judged_by(outcome.unexplained, *judge_adequacy(outcome.steps[-1], piece))
    unit = loop.unit("output", "%")
    position = from_position(near.longest_segment(), law=run.law, s_max=swing_of(piece, found),
                             rng=np.random.default_rng(run.options.seed), fit=near_fit)
    estimate = _estimate(last, unit, outcome, position, options.intervals)
    estimate = with_known_jump(widen_to_equivalents(estimate, outcome.reach), piece, outcome.steps)
    verdict = judge(run, with_stated_interval(near_fit, estimate), loop, position, outcome.steps)
    if verdict.stiction == "undecided" and verdict.evidence.code == UNANSWERED:
        return abstained(loop, found, options, CannotTell(verdict.reason, ASK, code=UNANSWERED))
    if unclear := _unclear(found, outcome.steps[-1]):
        return abstained(loop, found, options, CannotTell(unclear, _CLEARER, code="no-cycles"))
    notes += rounding_left(piece, estimate)
    severity, swing = meaning_of(piece, estimate, last, verdict)
    severity = with_controller(severity, controller)
    tell("done", 1.0)
    return with_change(loop, with_carrier(Study(
        made_by(options), data_record(loop, piece, notes), found, verdict, estimate, outcome.steps, laws=laws,
        adequate=holds, adequate_reason=why, cost_map=_cost_map(near_fit, len(outcome.steps) - 1),
        command=options.command, severity=severity, swing=swing, tree=outcome.tree, evaluations=outcome.evaluations,
        unasked=outcome.unasked, equivalents=outcome.equivalents, missing_reason=outcome.missing_reason,
        unexplained=outcome.unexplained, controller=controller, with_intervals=options.intervals)))


def _run_of(piece: Loop, found: Range, options: Options, method: Method, tell: Progress) -> Run:
    return Run(piece, found, options, law=options.law or method.law, order=options.order or method.order,
               rng=np.random.default_rng(options.seed), tell=tell)


def _outcome(method: Method, run: Run, policy: Policy | None) -> Outcome:
    """Result of the method; one that searches over models gets the policy."""
    return method.run(run, policy or Policy()) if "policy" in method.options else method.run(run)


def _unclear(found: Range, step: Step) -> str:
    """The reason for silence where the output turns at uneven distances and the best model is far from the noise."""
    e = step.error
    if found.reference != BY_TURNS or found.oscillating or not e.noise_sd or e.best < _FAR * e.noise_sd:
        return ""
    return f"{found.reason}; and the best model errs by {e.best / e.noise_sd:.2g} times the noise"


def _every_law(piece: Loop, found: Range, options: Options, method: Method, policy: Policy | None,
               tell: Progress) -> tuple[Run, Outcome, tuple[LawResult, ...]]:
    """The method with every searchable law: run and outcome of the one to keep, and all laws ranked, best first.

    A law whose valve never moves drops out; CannotTell where all do. Every law starts from the same seed.
    """
    names = searchable()
    tried: dict[str, tuple[Run, Outcome]] = {}
    failed: CannotTell | None = None
    for i, name in enumerate(names):
        tell(f"law {name}", (i + 0.1) / (len(names) + 1))
        run = _run_of(piece, found, replace(options, law=name), method, lambda text, share: None)
        try:
            tried[name] = run, _outcome(method, run, policy)
        except CannotTell as reason:
            failed = reason
    if not tried:
        raise failed or CannotTell("no law could be fitted", "look at the trend with stictionid read")
    ranking = law_ranking.rank({name: (o.steps[-1], o.fits[-1]) for name, (_, o) in tried.items()},
                           period=max(int(found.period_median_s / piece.step_s), 1) if found.period_median_s else 1)
    run, outcome = tried[ranking.keep]
    last = replace(outcome.steps[-1], findings=(*outcome.steps[-1].findings, ranking.finding))
    return run, replace(outcome, steps=(*outcome.steps[:-1], last)), ranking.laws


def _estimate(fit: Fitted, unit: str, outcome: Outcome, position: PositionEstimate | None, spans: bool) -> Estimate:
    v = fit.best.values
    process = process_numbers(fit)
    if outcome.process is not None:
        p = outcome.process
        process = {"gain": p.gain, "time_constants_s": p.time_constants_s, "dead_time_s": p.dead_time_s,
                   "integrating": p.integrating}
    # A value that is not estimated is anywhere in its range: its interval can say so, the value cannot.
    J_interval = fit.intervals.get("J") if outcome.gives_jump or not spans else (0.0, v["S"])
    return Estimate(v["S"], v["J"], unit, fit.intervals.get("S"), J_interval, INTERVAL_LEVEL, fit.model.spec.law,
                    initial_residual_force=v["initial_residual_force"], from_position=position,
                    scatter=scatter_of(fit.model, fit.values, unit), S_pieces=fit.pieces.get("S"),
                    J_pieces=fit.pieces.get("J"), **process)


def _cost_map(fit: Fitted, step: int) -> CostMap:
    """Error over S and J with everything else held at its best, for the picture; S and J of the fit are on its axes.

    It is the error that the fit made small: that one step ahead where it has a noise model. Searches that ended before
    the model had one are left out, because theirs is another map.
    """
    S_best, J_best = (float(fit.best.values[name]) for name in ("S", "J"))
    S = np.unique([*np.linspace(0.05 * fit.model.s_max, 1.2 * fit.model.s_max, _MAP_S), S_best])
    J = np.unique([*(np.linspace(0.0, 1.5, _MAP_J) * min(S_best * 1.4, fit.model.s_max)), J_best])
    grid = np.stack([S.repeat(J.size), np.tile(J, S.size)])
    valid = grid[1] <= 2.0 * grid[0]
    values = fit.values[:, None].repeat(int(valid.sum()), axis=1)
    values[:2] = grid[:, valid]
    rmse = np.full(grid.shape[1], np.nan)
    rmse[valid] = np.sqrt(fit.model.along(None).costs_of(values) / max(fit.best.rows, 1))
    own = bool((np.abs(fit.searched - [S_best, J_best]).max(axis=1) <= _NEAR * fit.model.s_max).any())
    rows = [tuple(None if not np.isfinite(x) else float(x) for x in row) for row in rmse.reshape(S.size, J.size)]
    return CostMap(tuple(S.tolist()), tuple(J.tolist()), tuple(rows),
                   tuple((float(a), float(b)) for a, b in fit.searched) if own else (), step)


def made_by(options: Options) -> CreatedBy:
    """Versions and seed for a study."""
    import numba

    return CreatedBy(__version__, options.seed, platform.python_version(), np.__version__, numba.__version__)


def data_record(loop: Loop, piece: Loop, notes: tuple[Finding, ...] = ()) -> DataRecord:
    o = loop.origin
    return DataRecord(o.file, o.sha256, dict(o.columns), dict(o.units or loop.units), o.rows or loop.samples,
                      int(piece.used.sum()), loop.step_s, o.start, o.end, (*o.findings, *notes), loop.name,
                      dict(o.options), steps_of(loop))


def abstained(loop: Loop, found: Range, options: Options, reason: CannotTell) -> Study:
    finding = Finding(reason.code, "serious", reason.message, {}, (), reason.hint)
    return Study(made_by(options), data_record(loop, loop, (finding,)), found,
                 Verdict("undecided", reason.message + (f"; {reason.hint}" if reason.hint else ""), 0.0,
                         Evidence(code=reason.code)), None, command=options.command)
