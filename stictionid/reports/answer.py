"""The answer of a search in sentences, and the change that one effect makes to the numbers of a study.

The names, sentences and actions are those of the effects; the numbers are those of the study's steps and candidates.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ..fit.adequacy import ADEQUATE, placed_slips_words, unknown_output
from ..record.study import Candidate, Study
from . import effect_words, wording
from .document import PageTable


def answers(study: Study, *, applied: bool, before: Study | None = None) -> tuple[str, ...]:
    """One line for each effect that the search named, or one line that says what else it found.

    `before` is the study that the search began with.

    `applied` is true where the named effects are in the study's steps; then a line on what is still missing follows.
    """
    known = [s.error.best for s in (before or study).steps]
    named = tuple(_named(study, name, applied, known) for name in study.missing)
    if named and not applied:
        return (*named, *([f"beside it: {wording.clean(study.missing_reason)}"] if study.missing_reason else []))
    if named and (study.adequate is not False or study.completed):
        return (*named, *([wording.sentence(study.adequate_reason)] if study.completed else []))
    return (*named, ("still " if named else "") + _unnamed(study))


def named_candidate(study: Study, name: str) -> Candidate | None:
    """The candidate of an effect that the search named; None in a study without one."""
    return next((c for c in study.candidates if c.accepted and c.effect == name), None)


def spelled(c: Candidate) -> str:
    """The effect of a candidate with its variant, as commands take it."""
    effect, _ = effect_words.known(c.effect)
    mark = "@" if effect is not None and c.variant in effect.variants else ":"
    return c.effect + (f"{mark}{c.variant}" if c.variant else "")


def _named(study: Study, name: str, applied: bool, known: Collection[float]) -> str:
    """The line on one named effect: its size, the error before and after, the held-out blocks, and the action.

    Where none of the `known` errors is that of the base, the search has changed the base.
    """
    c = named_candidate(study, name)
    at = next((i for i, step in enumerate(study.steps) if i and applied and step.added == name), None)
    shown, full, before, after = study, name, None, None
    if at is not None:
        full = effect_words.named_in(study.steps[at])
        before, after = study.steps[at - 1].error.best, study.steps[at].error.best
    elif c is not None and study.steps:
        # The words take their numbers from a step; the effect is in none yet.
        full = spelled(c)
        shown = replace(study, steps=(*study.steps, replace(study.steps[-1], parameters=c.parameters)))
        before, after = study.steps[-1].error.best, c.rmse
    effect, _ = effect_words.known(full)
    sized = effect is None or effect_words.parameters(shown, full)
    said = effect.summary if effect is not None and not sized else effect_words.sentence(shown, full).rstrip(".")
    said = said if said[:2].isupper() else said[:1].lower() + said[1:]
    parts = [f"{'added' if applied else 'missing'}: {said} ({wording.name(full)})."]
    if before is not None and after is not None:
        first = at == 1 and wording.number(before) not in (wording.number(r) for r in known)
        parts.append(f"Error {wording.number(before)}{' on a new base' * first} -> {_level(study, after)}.")
    if c is not None and c.blocks:
        parts.append(f"Better on {c.blocks_better} of {c.blocks} held-out blocks.")
    return " ".join((*parts, effect_words.action(shown, full))).rstrip()


def _unnamed(study: Study) -> str:
    """The line of a search that names nothing: nothing is missing, or nobody knows what."""
    error = study.steps[-1].error
    if study.adequate is not False or study.completed:
        if error.noise_sd and error.unavoidable and error.best <= ADEQUATE * error.unavoidable:
            more = "" if error.best <= ADEQUATE * error.noise_sd else \
                f" and what unknown {unknown_output(study.steps[-1])} add"
            by_pv = placed_slips_words(study.steps[-1])
            return f"missing: nothing. The free-run error {wording.number(error.best)}{by_pv} is the noise{more}."
        return f"missing: nothing, {wording.clean(study.adequate_reason)}"
    why = wording.sentence(study.missing_reason) or "No effect of the catalogue helps enough."
    return f"missing: unknown. Error {_level(study, error.best)}. {why}"


def _level(study: Study, rmse: float) -> str:
    """An error in the unit of y, and its size beside the noise."""
    noise = study.steps[-1].error.noise_sd
    shown = wording.with_unit(rmse, study.data.units.get("process_value") or "")
    if not noise:
        return shown
    return f"{shown}, " + ("the noise" if rmse <= ADEQUATE * noise else
                           f"{wording.times(rmse, noise)} x the noise {wording.number(noise)}")


def change(before: Study, after: Study) -> PageTable:
    """Error, S, J and verdict of two studies; both errors are beside the noise of `after`."""
    noise = after.steps[-1].error.noise_sd
    unit = after.data.units.get("process_value") or "unit of y"

    def column(study: Study) -> tuple[str, ...]:
        error, e = study.steps[-1].error.best, study.estimate
        sizes = (wording.NOTHING,) * 2 if e is None else (
            wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces),
            wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=e.J_known))
        return (wording.with_unit(error, unit), wording.times(error, noise), *sizes,
                f"{wording.name(study.verdict.stiction)} ({study.verdict.confidence:.2f})")

    labels = ("free-run error", "x noise", "S", "J", "verdict")
    return PageTable("What changed", ("", "before", "after"),
                     tuple(zip(labels, column(before), column(after), strict=True)), (1, 2))
