"""The Python interface at length: curves of a file, and the lines of the page on Python."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import test_api
from test_api import spoilt

import stictionid as st

# Fixtures of tests/.
frame = test_api.frame


def test_curves_of_a_file_have_its_rows_and_times(tmp_path: Path, frame: pd.DataFrame) -> None:
    rows = spoilt(frame)[:600].assign(when=lambda f: f["when"].dt.tz_localize(None).dt.strftime("%Y-%m-%d %H:%M:%S"))
    file = tmp_path / "a.csv"
    rows.to_csv(file, index=False)
    study = st.identify(str(file), base_only=True, intervals=False)
    found = study.curves()
    assert len(found) == len(rows)
    assert found.index.equals(pd.DatetimeIndex(pd.to_datetime(rows["when"]), name="when"))
    again = st.Study.load(study.save(tmp_path / "s.json"))
    assert again.loop is None and again.curves().equals(found)


def test_the_lines_of_the_page_on_python_run_as_written(frame: pd.DataFrame, tmp_path: Path,
                                                        monkeypatch: pytest.MonkeyPatch,
                                                        capsys: pytest.CaptureFixture[str]) -> None:
    test_api.test_the_lines_of_a_page_run_as_written("docs/python.md", frame, tmp_path, monkeypatch, capsys)
