"""The command `read`: tables, JSON, exit codes, profiles, cleaned files."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
from commands import HANGS_S, run
from historian_files import comma, record, wide

from stictionid.historian import read

R = record(rows=300)


def test_table_on_stdout_and_guesses_on_stderr(tmp_path):
    path = tmp_path / "export.csv"
    path.write_text(wide(R, names="time,A7.SV,A7.PV,A7.MV"))
    done = run("read", path)
    assert done.returncode == 0
    out, err = done.stdout, done.stderr
    assert "A7.MV" in out and "used" in out and "300" in out
    assert "guessed: output is 'A7.MV'" in err and "--op" in err
    assert "Traceback" not in err


def test_json_is_all_there_is_on_stdout(tmp_path):
    path = tmp_path / "export.csv"
    path.write_text(wide(R) + "(300 rows affected)\n")
    content = json.loads(run("read", path, "--json").stdout)
    assert content["columns"] == {
        "time": "timestamp",
        "setpoint": "FIC101.SP",
        "process_value": "FIC101.PV",
        "output": "FIC101.OP",
    }
    assert content["rows"] == {"in": 301, "used": 300, "footer": 1}
    assert content["step_s"] == 1.0
    assert content["units"]["output"] == "%"


def test_standard_input(tmp_path):
    done = run("read", "-", "--json", "--quiet", stdin=wide(R))
    assert json.loads(done.stdout)["rows"]["used"] == 300
    assert done.stderr == ""


def test_exit_codes(tmp_path):
    good, bad = tmp_path / "good.csv", tmp_path / "bad.csv"
    good.write_text(wide(R))
    other = tmp_path / "other.csv"
    other.write_text(wide(R))
    bad.write_bytes(b"PK\x03\x04 no workbook")
    for arguments, code, words in (
        ((tmp_path / "nothing.csv",), 2, "does not exist"),
        ((bad,), 3, "unpacked"),
        ((good, "--op", "Z"), 3, "'Z'"),
        ((good, "--loop", "Z9"), 2, "Z9"),
        ((good, "--span-op", "9"), 2, "--span-op"),
        ((good, "--bogus"), 2, "--bogus"),
        ((good, "-o", tmp_path / "no" / "a.parquet"), 2, "does not exist"),
        ((good, "-o", good), 2, "itself"),
        ((good, "-o", other), 2, "another kind"),
        ((good, "--step", "-1"), 2, "--step"),
        ((good, "-o", "a.xls"), 2, ".parquet"),
    ):
        done = run("read", *arguments)
        err = done.stderr
        assert done.returncode == code, err
        assert words in err and "Traceback" not in err
        assert done.stdout == ""


def test_cleaned_file_reads_back_to_the_same_loop(tmp_path):
    lines = wide(R).splitlines()
    lines[51] = lines[51].rsplit(",", 1)[0] + ",Bad"
    path = tmp_path / "export.csv"
    path.write_text("\n".join([*lines[:101], *lines[131:]]) + "\n")
    first = read(path)
    for name in ("clean.parquet", "clean.csv"):
        assert run("read", path, "-o", tmp_path / name).returncode == 0
        again = read(tmp_path / name).loop
        for role in ("setpoint", "process_value", "output", "used"):
            np.testing.assert_array_equal(getattr(again, role), getattr(first.loop, role))
        assert again.starts == first.loop.starts == (0, 100)
        assert again.step_s == first.loop.step_s


def test_profile_is_saved_and_applied(tmp_path):
    path, profile = tmp_path / "export.csv", tmp_path / "site.toml"
    early = record(rows=300, start=R.stamps[0].replace(month=3, day=4))
    path.write_text(wide(early, sep=";", cell=comma, stamp=lambda m: m.strftime("%d/%m/%Y %H:%M:%S")))
    assert run("read", path).returncode == 3
    assert (
        run(
            "read", path, "--dayfirst", "--span-pv", "0,100", "--mode-map", "1=AUTO", "--save-profile", profile
        ).returncode
        == 0
    )
    content = json.loads(run("read", path, "--profile", profile, "--json").stdout)
    assert content["start"] == "2024-03-04T14:00:00"
    assert content["units"]["process_value"] == "%"
    profile.write_text("# stictionid\ndayfirst = 'yes'\n")
    assert run("read", path, "--profile", profile).returncode == 3
    assert run("read", path, "--profile", tmp_path / "none.toml").returncode == 2


def test_a_site_sets_itself_up_once(tmp_path):
    """What one export had to have guessed is no guess for the next loop's when the profile is applied."""
    def export(name, loop):
        path = tmp_path / name
        text = wide(R, sep=";", cell=comma, names=f"Zeit,{loop}.SV,{loop}.PV,{loop}.MV,{loop}.Größe",
                    stamp=lambda m: m.replace(day=3).strftime("%d.%m.%Y %H:%M:%S"))
        lines = text.splitlines()
        path.write_bytes("\n".join([lines[0], *(f"{line};1,5" for line in lines[1:])]).encode("cp1252") + b"\n")
        return path

    first, second, profile = export("a.csv", "FIC101"), export("b.csv", "PIC7"), tmp_path / "site.toml"
    assert run("read", first, "--no-guess").returncode == 3
    assert run("read", first, "--pv", "FIC101.PV", "--save-profile", profile).returncode == 0
    assert "FIC101" not in profile.read_text(encoding="utf-8")
    done = run("read", second, "--no-guess", "--profile", profile, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["assumptions"] == []


def test_help_shows_an_example_that_runs_and_stays_light():
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "stictionid", "read", "--help"],
        capture_output=True,
        text=True,
        timeout=HANGS_S,
    )
    assert "stictionid read" in done.stdout and "--span-op" in done.stdout
    assert not any(heavy in done.stderr for heavy in ("numpy", "pandas", "pyarrow"))


def test_clean_files_need_neither_pandas_nor_scipy(tmp_path):
    path = tmp_path / "export.csv"
    path.write_text(wide(R))
    code = (
        f"import sys; from stictionid.historian import read_loop; read_loop(r'{path}'); "
        "print('pandas' in sys.modules, 'scipy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANGS_S)
    assert done.stdout.strip() == "False False", done.stderr
