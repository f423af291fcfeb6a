"""Candidates of a study in words, ranked by what they explain beyond the best noise model."""

from __future__ import annotations

from dataclasses import dataclass

from ..record.study import Candidate, Study
from ..record.tree import added_to
from . import effect_words, wording
from .document import PageTable, Section

NAMED, ALIKE, REJECTED = "named", "explains it as well", "not taken"
COLUMNS = ("effect", "gain beyond noise", "error", "answer", "would have shown from")
# Most effects in the table of an earlier step, best first; the tree has all.
_MOST_BEFORE = 5


@dataclass(frozen=True, slots=True)
class Ranked:
    """One candidate with its name, its answer (NAMED, ALIKE or REJECTED), and the answer in words."""

    candidate: Candidate
    name: str
    answer: str
    words: str


def ranked(study: Study) -> tuple[Ranked, ...]:
    """The named effect, then those that explain as much, then the others by their gain."""
    alike = {name for c in study.candidates if c.accepted for name in c.equivalent_to}
    found = []
    for c in study.candidates:
        name = wording.name(c.effect + (f"@{c.variant}" if c.variant else ""))
        answer = NAMED if c.accepted else ALIKE if c.effect in alike else REJECTED
        words = answer if answer != REJECTED else wording.clean(c.rejected_because, 200) or answer
        found.append(Ranked(c, name, answer, words))
    order = (NAMED, ALIKE, REJECTED)
    return tuple(sorted(found, key=lambda r: (order.index(r.answer), -_gain(r.candidate))))


def _gain(c: Candidate) -> float:
    return float("-inf") if c.gain_beyond_noise is None else c.gain_beyond_noise


def step_of(study: Study) -> int:
    """Index of the step that the candidates competed for; the number of steps where it has not been added."""
    named = {c.effect for c in study.candidates if c.accepted}
    return next((i for i in range(len(study.steps) - 1, 0, -1) if study.steps[i].added in named),
                max(len(study.steps), 1))


def _tried_at(study: Study, i: int) -> str:
    """The caption of the effects that competed for step `i`."""
    before = [wording.name(n) for n in study.steps[i - 1].effects] if study.steps else []
    beside = f"the base model with {wording.listed(before)}" if before else "the base model"
    return f"Effects tried at step {i}, beside {beside}"


def table(study: Study) -> PageTable:
    """All candidates with their gain, free-run error and answer."""
    rows = tuple((r.name, wording.number(r.candidate.gain_beyond_noise), wording.number(r.candidate.rmse), r.words,
                  wording.clean(r.candidate.detectable_from or wording.NOTHING, 80)) for r in ranked(study))
    return PageTable(f"{_tried_at(study, step_of(study))}, by what they explain beyond the best noise model", COLUMNS,
                     rows, (1, 2))


def _before(study: Study) -> tuple[PageTable, ...]:
    """The best effects tried at each step before that of the candidates, from the tree."""
    found = []
    for i in range(1, min(step_of(study), len(study.steps))):
        nodes = sorted(added_to(study.tree, study.steps[i - 1].effects), key=lambda n: (n[0].status != "named", -n[1]))
        rows = []
        for node, gain in nodes[:_MOST_BEFORE]:
            why = next((g.reason for g in node.gates if not g.passed), "")
            words = NAMED if node.status == "named" else wording.clean(why, 200) or (
                "no full fit was made" if node.status == "looked" else "the search from it ended worse")
            rows.append((wording.name(node.edge.what), wording.number(gain), wording.number(node.rmse), words))
        if rows:
            best = f", the best {len(rows)} of {len(nodes)}" if len(nodes) > len(rows) else ""
            found.append(PageTable(_tried_at(study, i) + best, COLUMNS[:4], tuple(rows), (1, 2)))
    return tuple(found)


def section(study: Study) -> Section | None:
    """The catalogue's effects refitted into the model; None where `diagnose` has not run."""
    if not study.candidates:
        return None
    text = ["The gain beyond noise is that over the best model of the noise alone, in BIC; 10 name an effect. The "
            "error is that of the free run."]
    first = ranked(study)[0]
    if first.answer == NAMED:
        alike = [r.name for r in ranked(study) if r.answer == ALIKE]
        can = f" {wording.listed(alike)} can't be told from it." if alike else ""
        text.insert(0, wording.sentence(f"Named: {effect_words.noun(study, first.candidate.effect)}") + can)
    bullets = tuple(wording.sentence(r.candidate.statement) for r in ranked(study)
                    if r.answer == NAMED and r.candidate.statement)
    return Section("candidates", "What else could be there", tuple(text), bullets, (table(study), *_before(study)),
                   ("candidates",))
