"""Methods at length: laws that no signal tells apart, and all laws ranked on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_methods import loop_of, ranks

from stictionid.verbs.identify import Options, identify


def test_chen_and_kano_cannot_be_told_apart_and_the_default_is_kept() -> None:
    study = identify(loop_of(), options=Options(law="all", base_only=True))
    finding = next(f for f in study.steps[-1].findings if f.code == "laws-alike")
    assert {"chen", "kano"} <= set(finding.evidence["alike"]) and "he" not in finding.evidence["alike"]
    assert study.estimate is not None and study.estimate.law == "chen"
    by_name = {law.law: law for law in study.laws}
    assert pytest.approx(by_name["chen"].S, rel=0.01) == by_name["kano"].S


def test_all_laws_are_ranked_on_the_command_line(tmp_path: Path) -> None:
    ranks(tmp_path, {"chen", "kano", "he", "he-wang", "choudhury", "stenman"})
