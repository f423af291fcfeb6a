"""The command line: outputs, exit codes, refusals in one sentence, nothing half-written.

The main road goes through processes of its own, as do pipes and full disks; `commands.run` stands for them elsewhere.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import HANGS_S, run
from quick_loops import WORDS, identified_once

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_data"


def process(*arguments: object, cwd: Path | None = None, stdin: str | None = None):
    """One command in a process of its own."""
    return subprocess.run([sys.executable, "-m", "stictionid", *map(str, arguments)], capture_output=True, text=True,
                          cwd=cwd, input=stdin, timeout=HANGS_S, encoding="utf-8")


def refused(result, code: int) -> None:
    """One sentence and a hint on stderr, nothing on stdout, no traceback."""
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr and result.stdout == ""
    lines = [line for line in result.stderr.splitlines() if not line.startswith(("read ", "guessed", "note", "warning",
                                                                                 "serious"))]
    assert lines and lines[0].startswith("stictionid: ") and len(lines) <= 2, result.stderr


def test_the_main_road(tmp_path: Path) -> None:
    made = process("simulate", "--preset", "foptd", "--S", 5, "--J", 3, "--noise", 0.05, "--scan", 1,
                   "--duration", 500, "-o", "a.csv", cwd=tmp_path)
    assert made.returncode == 0 and made.stdout == ""
    truth = json.loads((tmp_path / "a.truth.json").read_text())
    assert (truth["S"], truth["J"], truth["law"], truth["step_s"]) == (5.0, 3.0, "chen", 1.0)
    found = json.loads(run("range", "a.csv", "--json", cwd=tmp_path).stdout)
    assert found["oscillating"] and {"period_s", "s_max", "cycles", "reason"} <= set(found)
    table = run("range", "a.csv", cwd=tmp_path).stdout
    assert max(map(len, table.splitlines())) <= 80 and "S_max" in table
    study = process("identify", "a.csv", "--base-only", "-o", "study.json", "--json", cwd=tmp_path)
    assert study.returncode == 0
    content = json.loads(study.stdout)
    assert content == json.loads((tmp_path / "study.json").read_text())
    assert next(iter(content)) == "schema" and content["schema"] == "stictionid.study/1"
    assert content["estimate"]["S"] == pytest.approx(5.0, rel=0.01)
    assert content["data"]["sha256"] and content["data"]["columns"]["output"] == "OP"
    assert content["steps"][0]["restarts"]["agree"] >= 1
    again = run("identify", "a.csv", "--base-only", "--json", cwd=tmp_path).stdout
    assert json.loads(again)["estimate"] == content["estimate"]


def test_tables_fit_80_columns_and_say_what_they_show() -> None:
    with identified_once():
        shown = run("identify", SAMPLE / "foptd_scanned.parquet")
    assert shown.returncode == 0 and max(map(len, shown.stdout.splitlines())) <= 80
    for word in ("verdict: stiction", "S stickband", "J slip jump", "dead time", "held out", "restarts"):
        assert word in shown.stdout


def test_the_range_of_a_j_that_is_not_known_has_its_unit() -> None:
    with identified_once():
        shown = run("identify", SAMPLE / "healthy.csv")
    assert re.search(r"J slip jump +\| +unknown \| +\S+ to \S+ % \|", shown.stdout), shown.stdout


def test_simulate_writes_the_same_bytes_for_a_seed_in_csv_and_parquet(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv", "c.parquet", "d.parquet"):
        assert run("simulate", "--noise", 0.1, "--seed", 7, "--duration", 60, "-o", tmp_path / name,
                   "--no-truth").returncode == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (tmp_path / "c.parquet").read_bytes() == (tmp_path / "d.parquet").read_bytes()
    assert not list(tmp_path.glob("*.truth.json"))
    import pyarrow.parquet as pq

    text = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    assert (pq.read_table(tmp_path / "c.parquet")["PV"].to_numpy() == text["PV"]).all()


BAD_SIMULATIONS = [
    (["--S", "-1"], "-1"), (["--S", "2", "--J", "5"], "J = 5"), (["--preset", "nobody"], "nobody"),
    (["--law", "nobody"], "nobody"), (["--step", "0"], "--step 0"), (["--setpoint", "5"], "TIME:SIZE"),
    (["--effect", "nobody:x=1"], "nobody"), (["--scan", "0.3"], "0.3"), (["--noise", "-1"], "-1"),
    (["--gain", "0"], "gain"), (["--seed", "-1"], "-1"),
]


@pytest.mark.parametrize(("arguments", "named"), BAD_SIMULATIONS, ids=[" ".join(a) for a, _ in BAD_SIMULATIONS])
def test_simulate_refuses_with_the_value(arguments: list[str], named: str, tmp_path: Path) -> None:
    result = run("simulate", *arguments, "-o", tmp_path / "a.csv")
    refused(result, 2)
    assert named in result.stderr and not list(tmp_path.iterdir())


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def rows(n: int = 300, op: str = "{u}", pv: str = "{y}") -> str:
    lines = []
    for k in range(n):
        values = {"u": 50 + np.sin(k / 6), "y": 50 + np.cos(k / 6)}
        lines.append(f"{k},50,{pv.format(**values)},{op.format(**values)}")
    return "time_s,SP,PV,OP\n" + "\n".join(lines) + "\n"


BAD_FILES = {
    "missing column": ("time_s,SP,PV\n1,2,3\n2,2,4\n3,2,3\n", 3),
    "empty file": ("", 3),
    "only a header": ("time_s,SP,PV,OP\n", 3),
    "text where numbers belong": (rows(op="open"), 3),
    "constant OP": (rows(op="40"), 3),
    "PV without variation": (rows(pv="3.5e-44"), 3),
    "fewer than three cycles": (rows(60), 3),
    "all NaN": (rows(pv="NaN"), 3),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_content_ends_in_one_sentence(name: str, tmp_path: Path) -> None:
    text, code = BAD_FILES[name]
    file = write(tmp_path / "bad.csv", text)
    result = run("identify", file, "-o", tmp_path / "study.json", "--quiet")
    assert result.returncode == code and "Traceback" not in result.stderr
    if (tmp_path / "study.json").exists():  # read, but can't tell: a whole study with its reason
        study = json.loads((tmp_path / "study.json").read_text())
        assert study["estimate"] is None and study["verdict"]["stiction"] == "undecided" and study["verdict"]["reason"]
        assert "because: " in result.stdout
    else:
        refused(result, code)


@pytest.mark.parametrize("spoil", ["unsorted", "duplicates", "some NaN"])
def test_spoilt_but_usable_files_give_an_answer_or_a_reason(spoil: str, tmp_path: Path) -> None:
    """Unequal steps are in benchmarks/long."""
    assert run("simulate", *WORDS, "-o", "a.csv", "-q", cwd=tmp_path).returncode == 0
    head, *body = (tmp_path / "a.csv").read_text().splitlines()
    if spoil == "unsorted":
        body = body[200:] + body[:200]
    elif spoil == "duplicates":
        body = [line for i, line in enumerate(body) for _ in range(2 if i % 50 == 0 else 1)]
    elif spoil == "some NaN":
        body = [line.replace(line.split(",")[2], "NaN") if i % 97 == 5 else line for i, line in enumerate(body)]
    else:
        body = [line for i, line in enumerate(body) if i % 83]
    result = run("identify", write(tmp_path / "spoilt.csv", "\n".join([head, *body]) + "\n"), "--base-only", "--json",
                 "--no-intervals")
    assert result.returncode in (0, 3) and "Traceback" not in result.stderr
    study = json.loads(result.stdout)
    assert study["verdict"]["reason"]
    if spoil in ("unsorted", "duplicates", "some NaN"):
        assert study["estimate"]["S"] == pytest.approx(4.0, rel=0.03), study["verdict"]


def test_usage_errors_are_exit_2(tmp_path: Path) -> None:
    good = SAMPLE / "foptd.csv"
    for arguments in (["identify", tmp_path / "absent.csv"], ["identify", good, "--law", "nobody"],
                      ["identify", good, "--method", "magic"], ["identify", good, "--between", "never"],
                      ["identify", good, "-o", tmp_path / "no" / "folder" / "s.json"],
                      ["identify", good, "--op", "nobody"],
                      ["nonsense"], ["identify", good, "--nonsense"], ["identify", good, "--with", "nobody"],
                      ["identify", good, "-o", tmp_path]):
        result = run(*arguments, "--quiet") if arguments[0] == "identify" else run(*arguments)
        assert "Traceback" not in result.stderr
        expected = 3 if "--op" in arguments else 2
        assert result.returncode in (2, expected), (arguments, result.stderr)
        assert result.stderr.startswith("stictionid: ")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    refused(run("identify", SAMPLE / "foptd.csv", "-q", "-o", tmp_path / "s.json"), 2)


def test_a_file_of_another_kind_is_not_overwritten(tmp_path: Path) -> None:
    precious = write(tmp_path / "precious.json", "not a study")
    refused(run("identify", SAMPLE / "foptd.csv", "-q", "-o", precious), 2)
    assert precious.read_text() == "not a study"


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with Path("/dev/full").open("w") as full:
        result = subprocess.run([sys.executable, "-m", "stictionid", "range", str(SAMPLE / "foptd.csv"), "-q"],
                                stdout=full, stderr=subprocess.PIPE, text=True, timeout=HANGS_S)
    assert result.returncode == 2 and "Traceback" not in result.stderr


def test_a_reader_that_closes_the_pipe_is_no_error() -> None:
    command = (f"{sys.executable} -m stictionid range {SAMPLE / 'itptd.parquet'} -q --json | head -c 10; "
               "exit ${PIPESTATUS[0]}")
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=HANGS_S)
    assert result.returncode == 0 and "Traceback" not in result.stderr


def test_standard_input_is_read() -> None:
    result = process("range", "-", "--json", stdin=(SAMPLE / "foptd.csv").read_text())
    assert result.returncode == 0 and json.loads(result.stdout)["oscillating"]


def test_strict_makes_doubt_an_exit_code(tmp_path: Path) -> None:
    with identified_once():
        assert run("identify", SAMPLE / "foptd_scanned.parquet", "--strict", "-q").returncode == 0
    made = run("simulate", "--S", 4, "--J", 2, "--noise", 0.05, "--scan", 1, "--duration", 600, "-o", "a.csv",
               "--effect", "sinusoidal-disturbance:period_s=17,amplitude=0.3", cwd=tmp_path)
    assert made.returncode == 0
    done = run("identify", "a.csv", "--base-only", "--no-intervals", "--json", "-q", "--strict", cwd=tmp_path)
    assert done.returncode == 4 and not json.loads(done.stdout)["adequate"]


@pytest.mark.parametrize("command", ["simulate", "range", "identify", "read", "report", "laws", "agree",
                                     "effects", "study"])
def test_every_help_has_an_example_that_runs(command: str, tmp_path: Path) -> None:
    text = run(command, "--help", env={"COLUMNS": "200"}).stdout
    examples = [line.split("Example:", 1)[1].strip() for line in text.splitlines() if "Example:" in line]
    assert examples, text
    if command == "report":
        return
    words = [str(SAMPLE / w.removeprefix("sample_data/")) if w.startswith("sample_data/") else w
             for w in examples[0].split()[1:]]
    # The examples of `agree` and `identify` search for effects: base models say as much about their words.
    shorter = {"agree": ["--base-only", "--windows", 2], "identify": ["--base-only"]}.get(command, [])
    with identified_once():
        assert run(*words, *shorter, cwd=tmp_path).returncode == 0


def test_selftest_prints_its_rates_and_passes() -> None:
    """One loop with nothing hidden; rates of hidden effects are asked of none."""
    done = run("selftest", "--loops", 1, "--jobs", 1, "-q")
    assert done.returncode == 0, done.stderr + done.stdout
    rows = {cells[0]: cells[1:] for line in done.stdout.splitlines()
            if len(cells := [cell.strip() for cell in line.strip("|").split("|")]) == 4}
    assert "selftest on 1 loop" in done.stdout and done.stdout.rstrip().endswith("passed")
    assert rows["false alarms in clean loops"] == ["0 of 1", "at most 2 %", "yes"]
    assert rows["right names of hidden effects"] == ["0 of 0", "at least 90 %", "yes"]
    assert rows["S in its 90 % interval"] == ["1 of 1", "at least 85 %", "yes"]
