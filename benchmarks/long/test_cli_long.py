"""The command line at length: a file of unequal steps gives an answer or a reason."""

from __future__ import annotations

from pathlib import Path

import test_cli


def test_a_file_of_unequal_steps_gives_an_answer_or_a_reason(tmp_path: Path) -> None:
    test_cli.test_spoilt_but_usable_files_give_an_answer_or_a_reason("unequal steps", tmp_path)
