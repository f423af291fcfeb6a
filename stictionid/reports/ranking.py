"""Candidates of a study in words: every effect asked, ranked by what the best model gains by it."""

from __future__ import annotations

from dataclasses import dataclass

from ..record.study import Candidate, Study
from . import effect_words, wording
from .document import PageTable, Section

NAMED, KEPT, ALIKE, REJECTED = "named", "in the model", "explains it as well", "not taken"
COLUMNS = ("effect", "error", "x noise", "gain beyond noise", "answer", "would have shown from")


@dataclass(frozen=True, slots=True)
class Ranked:
    """One candidate with its name, its answer (NAMED, KEPT, ALIKE or REJECTED), and the answer in words."""

    candidate: Candidate
    name: str
    answer: str
    words: str


def ranked(study: Study) -> tuple[Ranked, ...]:
    """The named effects as the search ordered them, those of the model, those that explain as much, the others by gain.
    """
    have = set(study.steps[-1].effects) if study.steps else set()
    alike = {name for c in study.candidates if c.accepted for name in c.equivalent_to}
    found = []
    for c in study.candidates:
        name = wording.name(c.effect + (f"@{c.variant}" if c.variant else ""))
        answer = NAMED if c.accepted else KEPT if c.effect in have else ALIKE if c.effect in alike else REJECTED
        words = answer if answer != REJECTED else wording.clean(c.rejected_because, 200) or answer
        found.append(Ranked(c, name, answer, words))
    order = (NAMED, KEPT, ALIKE, REJECTED)
    return tuple(sorted(found, key=lambda r: (order.index(r.answer), r.answer != NAMED and -_gain(r.candidate))))


def _gain(c: Candidate) -> float:
    return float("-inf") if c.gain_beyond_noise is None else c.gain_beyond_noise


def table(study: Study) -> PageTable:
    """All candidates with their free-run error, gain and answer."""
    noise = study.steps[-1].error.noise_sd if study.steps else None
    rows = tuple((r.name, wording.number(r.candidate.rmse), wording.times(r.candidate.rmse, noise),
                  wording.number(r.candidate.gain_beyond_noise), r.words,
                  wording.clean(r.candidate.detectable_from or wording.NOTHING, 80)) for r in ranked(study))
    return PageTable("Every effect asked, each by the best model that holds it", COLUMNS, rows, (1, 2, 3))


def section(study: Study) -> Section | None:
    """The catalogue's effects refitted into the model; None where `diagnose` has not run."""
    if not study.candidates:
        return None
    text = ["The gain beyond noise is the BIC of the best model that holds an effect over the best one without it, "
            "both completed with noise; 20 name an effect, 10 a lag or a rest. The error is that of the free run of a "
            "model fitted beside its noise model. Fitted without one, a free run may err less."]
    first = ranked(study)[0]
    if first.answer == NAMED:
        alike = [r.name for r in ranked(study) if r.answer == ALIKE]
        can = f" {wording.listed(alike)} can't be told from it." if alike else ""
        text.insert(0, wording.sentence(f"Named: {effect_words.noun(study, first.candidate.effect)}") + can)
    bullets = tuple(wording.sentence(r.candidate.statement) for r in ranked(study)
                    if r.answer == NAMED and r.candidate.statement)
    return Section("candidates", "What else could be there", tuple(text), bullets, (table(study),),
                   ("candidates",))
