"""The command line at the prompt: help, completion, widths, output options, visible defaults, `study`, `remove`.

Tables in terminals of two widths, and an effect that is taken out again, are in benchmarks/long.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import study_factory
from commands import run
from quick_loops import identified_once

import stictionid as st
from stictionid import laws
from stictionid.cli.app import app
from stictionid.cli.common.completion import effect_names, law_names
from stictionid.cli.common.output import FIRST_RUN, Progress, width_of
from stictionid.effects import catalogue
from stictionid.model.closed_loop import preset
from stictionid.model.visible import visible_values
from stictionid.numerics.machine_code import ahead
from stictionid.record.study import to_json
from stictionid.system.plurals import counted

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_data" / "foptd_scanned.parquet"
COMMANDS = sorted(c.name or c.callback.__name__ for c in app.registered_commands)  # type: ignore[union-attr]


def test_bare_it_prints_the_help() -> None:
    done = run()
    assert done.returncode == 0 and done.stderr == "" and done.stdout == run("--help").stdout
    assert done.stdout.startswith("Usage: stictionid ") and all(f"\n  {name} " in done.stdout for name in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_names_its_files_and_exit_codes(command: str) -> None:
    text = " ".join(run(command, "--help").stdout.split())
    assert re.search(r"Writes: .+\. .*Exit codes: 0 done.*; 2 usage.*; 3 .*; 130 interrupted\.", text), text
    assert ("4 with --strict" in text) == ("--strict" in text.split("Writes:")[0])
    assert " --out " not in text and ("-o, --output" in text or " -o" not in text)


@pytest.mark.parametrize(("shell", "word"), [("bash", "complete -o default"), ("zsh", "#compdef stictionid"),
                                             ("fish", "complete --command stictionid")])
def test_completion_is_shown_and_installed(shell: str, word: str, tmp_path: Path) -> None:
    shown = run("--show-completion", shell)
    assert shown.returncode == 0 and word in shown.stdout and "_STICTIONID_COMPLETE" in shown.stdout
    done = run("--install-completion", shell, env={"HOME": str(tmp_path)})
    assert done.returncode == 0 and str(tmp_path) in done.stderr
    assert word in "".join(p.read_text() for p in tmp_path.rglob("*") if p.is_file())
    refused = run("--show-completion", "tcsh")
    assert refused.returncode == 2 and "bash, zsh, fish" in refused.stderr


@pytest.mark.parametrize(("words", "number", "found"), [("stictionid identify --span", "2",
                                                         ["--span-pv", "--span-op"]),
                                                        ("stictionid add trav", "2", ["travel-limit"]),
                                                        ("stictionid remove gain-n", "2", ["gain-nonlinearity"]),
                                                        ("stictionid effects lea", "2", ["leak"]),
                                                        ("stictionid simulate --effect slip", "3", ["slip-overshoot"]),
                                                        ("stictionid identify --with back", "3", ["backlash"]),
                                                        ("stictionid identify --law ka", "3", ["kano", "karnopp"]),
                                                        ("stictionid laws he", "2", ["he", "he-wang"])])
def test_words_are_completed(words: str, number: str, found: list[str]) -> None:
    assert run(env=completing(words, number)).stdout.split() == found


def completing(words: str, number: str) -> dict[str, str]:
    """Environment that bash gives a command which completes a word."""
    return {"_STICTIONID_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": number}


def test_a_completion_loads_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-X", "importtime", "-m", "stictionid"], capture_output=True, text=True,
                          env={**os.environ, **completing("stictionid simulate --effect slip", "3")})
    assert done.stdout.split() == ["slip-overshoot"]
    assert not any(heavy in done.stderr for heavy in ("numpy", "numba", "pyarrow"))


def test_names_to_complete_are_those_of_the_catalogues() -> None:
    assert effect_names("") == sorted(catalogue()) and law_names("") == sorted(laws.catalogue())


@pytest.mark.parametrize("columns", [60, 200])
def test_tables_are_as_wide_as_asked(columns: int, tmp_path: Path) -> None:
    for kind in ("good", "searched", "abstained"):
        (tmp_path / f"{kind}.json").write_text(to_json(getattr(study_factory, kind)().study), encoding="utf-8")
    widths = []
    for words in (["effects"], ["laws", "chen"], ["range", SAMPLE], ["read", SAMPLE], ["report", "good.json"],
                  ["report", "searched.json"], ["report", "abstained.json"]):
        done = run(*words, "-q" if words[0] in ("range", "read", "report") else "--", cwd=tmp_path,
                   env={"COLUMNS": str(columns)})
        assert done.returncode == 0, done.stderr
        widths.append(max(map(len, done.stdout.splitlines())))
    assert max(widths) <= columns and max(widths) > columns - 30


def test_the_width_stays_between_60_and_200_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    for asked, width in (("20", 60), ("90", 90), ("999", 200), ("", 80), ("x", 80)):
        monkeypatch.setenv("COLUMNS", asked)
        assert width_of(terminal=False) == width


def in_terminal(commands: list[tuple[int, list[str]]]) -> dict[int, list[str]]:
    """Lines that commands of one process show in a terminal of so many columns each, without colours, by columns."""
    import pty

    ours, theirs = pty.openpty()
    env = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    code = "import sys\nfrom fcntl import ioctl\nfrom struct import pack\nfrom termios import TIOCSWINSZ\n" \
           f"from stictionid.cli import main\nfor columns, words in {commands!r}:\n" \
           "    ioctl(0, TIOCSWINSZ, pack('HHHH', 40, columns, 0, 0))\n    print(chr(0), columns, flush=True)\n" \
           "    sys.argv = ['stictionid', *words]\n    try:\n        main()\n    except SystemExit as e:\n" \
           "        assert not e.code"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=theirs, stdout=theirs, stderr=theirs,
                             env={**env, "NO_COLOR": "1", "TERM": "xterm"})
    os.close(theirs)
    text = b""
    try:
        while piece := os.read(ours, 4096):
            text += piece
    except OSError:
        pass  # the other end was closed
    os.close(ours)
    assert child.wait() == 0, text
    shown: dict[int, list[str]] = {}
    for part in text.decode().split("\0")[1:]:
        columns, *lines = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line).rstrip() for line in part.splitlines()]
        shown.setdefault(int(columns), []).extend(lines)
    return shown


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
def test_a_terminal_sets_the_width() -> None:
    columns = 132
    lines = in_terminal([(columns, ["laws", "chen"]), (columns, [])])[columns]
    assert columns - 30 < max(map(len, lines)) <= columns
    assert any(line.startswith("Usage: stictionid") for line in lines)


def test_a_line_of_progress_comes_every_few_seconds(capsys: pytest.CaptureFixture[str],
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = Progress(False)
    for now[0], share in ((0.5, 0.1), (1.5, 0.2), (6.0, 0.3), (7.0, 0.4), (12.0, 0.5)):
        progress("fitting", share)
    assert capsys.readouterr().err.splitlines() == ["fitting, 30 % after 6 s", "fitting, 50 % after 12 s"]


def test_counts_have_their_plural() -> None:
    assert [counted(n, "loop") for n in (0, 1, 2, 1200)] == ["0 loops", "1 loop", "2 loops", "1,200 loops"]
    assert counted(2, "sticks", "stick") == "2 stick"


def test_every_effect_has_numbers_that_show() -> None:
    setting = replace(preset("itptd"), duration_s=150.0)
    for effect in catalogue().values():
        values = visible_values(effect.name, setting)
        limits = {p.name: p for p in effect.parameters}
        assert values and set(values) <= set(limits)
        assert any(value != limits[name].neutral for name, value in values.items()), effect.name


def test_simulate_takes_an_effect_without_numbers_and_says_which_it_took(tmp_path: Path) -> None:
    base = ("simulate", "--noise", 0.05, "--scan", 1, "--duration", 300)
    done = run(*base, "--effect", "step-disturbance:at=load", "-o", "a.csv", cwd=tmp_path)
    said = re.search(r"--effect (\S+)$", done.stderr, re.M)
    assert done.returncode == 0 and said and said[1].startswith("step-disturbance:time_s=150,size=")
    run(*base, "--effect", said[1], "-o", "b.csv", cwd=tmp_path)
    run(*base, "-o", "c.csv", cwd=tmp_path)
    a, b, c = ((tmp_path / f"{n}.csv").read_bytes() for n in "abc")
    assert a == b and a != c
    truth = json.loads((tmp_path / "a.truth.json").read_text())
    assert truth["effects"][0]["parameters"]["at"] == "load" and truth["effects"][0]["parameters"]["size"] > 0
    assert run(*base, "--effect", "nobody", "-o", "d.csv", cwd=tmp_path).returncode == 2


def test_study_writes_the_page_and_the_study_beside_it(tmp_path: Path) -> None:
    with identified_once():
        done = run("study", SAMPLE, "-o", tmp_path / "site", "--strict")
    assert done.returncode == 0 and "verdict: stiction" in done.stdout and "missing: nothing" in done.stdout
    assert {p.name for p in (tmp_path / "site").iterdir()} == {"foptd_scanned.html", "foptd_scanned.json"}
    stages = [line.split(":")[0] for line in done.stderr.splitlines() if line.startswith(("read ", "identify: base",
                                                                                          "diagnose: base", "wrote "))]
    assert [s.split()[0] for s in stages] == ["read", "identify", "diagnose", "wrote", "wrote"]
    page = (tmp_path / "site" / "foptd_scanned.html").read_text(encoding="utf-8")
    study = json.loads((tmp_path / "site" / "foptd_scanned.json").read_text())
    assert "<figure" in page and study["candidates"] == [] and study["estimate"]["S"] == pytest.approx(4.0, rel=0.01)
    assert study["command"].startswith("stictionid study ")
    # The Python interface writes the same bytes again.
    st.Study.load(tmp_path / "site" / "foptd_scanned.json").save(tmp_path / "b.json")
    assert (tmp_path / "b.json").read_bytes() == (tmp_path / "site" / "foptd_scanned.json").read_bytes()


def test_study_of_a_record_that_can_not_tell_is_exit_3_with_page_and_study(tmp_path: Path) -> None:
    lines = (ROOT / "sample_data" / "foptd.csv").read_text().splitlines(keepends=True)
    (tmp_path / "short.csv").write_text("".join(lines[:60]))
    done = run("study", "short.csv", "-o", "loop.json", "--json", "-q", cwd=tmp_path)
    assert done.returncode == 3 and json.loads(done.stdout) == json.loads((tmp_path / "loop.json").read_text())
    assert "Can&#x27;t tell" in (tmp_path / "loop.html").read_text()
    for out, said in (("loop.pdf", "'loop.pdf'"), ("short.csv", "short.csv")):
        refused = run("study", "short.csv", "-o", out, cwd=tmp_path)
        assert refused.returncode == 2 and said in refused.stderr
    (tmp_path / "bad.csv").write_text("time_s,SP\n1,2\n2,3\n")
    assert run("study", "bad.csv", "-o", "bad.html", cwd=tmp_path).returncode == 3
    assert not list(tmp_path.glob("bad.[hj]*"))


def test_a_first_run_says_that_kernels_are_compiled(capsys: pytest.CaptureFixture[str],
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Progress(False) as progress:
        now[0] = 0.5
        progress("searching (S, J)", 0.1)
        for now[0] in (7.0, 9.0):
            ahead.listeners[-1](True)
        now[0] = 14.0
        progress("searching (S, J)", 0.4)
    assert not ahead.listeners
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == FIRST_RUN and "processor time" in first
    assert lines == ["1 kernel compiled after 7 s", "2 kernels compiled after 14 s"]
