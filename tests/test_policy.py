"""Numbers of the search: every field explained, files read or refused, options handed on, a batch begun anew."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from commands import run

from stictionid.batch.command import command_for
from stictionid.batch.task import Work
from stictionid.errors import UsageError
from stictionid.historian.bytes.options import ReadOptions
from stictionid.methods.option_check import check_options
from stictionid.options import Options
from stictionid.selection.policy import Policy, read_policy, with_budget

RECORD = Path(__file__).parents[1] / "sample_data" / "foptd.csv"
STUDY = Path(__file__).parent / "golden" / "study_schema_1.json"


def _file(folder: Path, text: str | bytes) -> Path:
    path = folder / "site.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_every_number_has_a_unit_a_meaning_and_its_benchmark() -> None:
    fields = dataclasses.fields(Policy)
    assert 0 < len(fields) <= 30
    for f in fields:
        assert {"unit", "meaning", "benchmark", "least"} <= set(f.metadata), f.name
        assert all(f.metadata[key] for key in ("unit", "meaning", "benchmark")), f.name
        assert f.type in ("int", "float") and type(f.default).__name__ == f.type, f.name


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    default = Policy()
    names = [f.name for f in dataclasses.fields(Policy)]
    assert read_policy(_file(tmp_path, "")) == default
    text = "".join(f"{name} = {getattr(default, name) + 1}\n" for name in names)
    assert read_policy(_file(tmp_path, text)) == replace(default, **{n: getattr(default, n) + 1 for n in names})
    assert read_policy(_file(tmp_path, "# a site\nbudget = 5_000\n")) == replace(default, budget=5000)


def test_a_whole_number_serves_as_a_decimal_one(tmp_path: Path) -> None:
    name = next(f.name for f in dataclasses.fields(Policy) if f.type == "float")
    value = getattr(read_policy(_file(tmp_path, f"{name} = 7")), name)
    assert value == 7.0 and isinstance(value, float)


@pytest.mark.parametrize(("text", "said"), [
    ("bugdet = 5", "unknown entry 'bugdet'"), ("rounding = 3.0", "entry 'rounding', which is gone"),
    ("kick_samples = 3.0", "entry 'kick_samples', which is gone"),
    ("at_noise = 1.1", "entry 'at_noise', which is gone"),
    ("[budget]\nmost = 1", "budget is {'most': 1}, not a whole number"),
    ("budget = 2.5", "budget is 2.5, not a whole number"), ("budget = true", "budget is True"),
    ("budget = '9'", "budget is '9'"), ("budget = 0", "budget 0 is below 1, the least"),
    ("budget = -3", "budget -3 is below 1"), ("budget =", "is no TOML"), ("budget = 1\nbudget = 2", "is no TOML"),
    ("{" * 5000, "is no TOML"), (b"\xff\xfe", "is not UTF-8 text"),
    ("budget = 1" + "0" * 6000, "is no TOML"),
])
def test_a_file_that_is_no_policy_is_refused_by_its_name(text: str | bytes, said: str, tmp_path: Path) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(UsageError) as refusal:
        read_policy(path)
    assert said in refusal.value.message and str(path) in refusal.value.message
    assert refusal.value.hint and refusal.value.exit_code == 2


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "1" + "0" * 400])
def test_decimal_numbers_are_finite_and_not_negative(value: str, tmp_path: Path) -> None:
    name = next(f.name for f in dataclasses.fields(Policy) if f.type == "float")
    with pytest.raises(UsageError, match=name):
        read_policy(_file(tmp_path, f"{name} = {value}"))


def test_an_absent_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(UsageError, match="can't be read"):
            read_policy(path)


def test_the_budget_goes_before_the_file() -> None:
    assert with_budget(Policy(), 10**400).budget == 10**400
    with pytest.raises(UsageError, match="budget 0 is below 1"):
        with_budget(Policy(), 0)


@pytest.mark.parametrize("command", [("identify", RECORD), ("diagnose", STUDY), ("batch", RECORD, "-o", "out")])
@pytest.mark.parametrize(("options", "said"), [
    (("--budget", 0), "budget 0 is below 1, the least"), (("--budget", -5), "budget -5 is below 1"),
    (("--policy", "none.toml"), "policy none.toml can't be read"),
    (("--policy", "site.toml"), "unknown entry 'bugdet'"),
])
def test_commands_refuse_before_they_work(command: tuple[object, ...], options: tuple[object, ...], said: str,
                                          tmp_path: Path) -> None:
    _file(tmp_path, "bugdet = 5")
    out = run(*command, *options, cwd=tmp_path)
    assert out.returncode == 2 and out.stdout == ""
    assert said in out.stderr and not (tmp_path / "out").exists()


def test_identify_and_diagnose_hand_the_policy_on(tmp_path: Path) -> None:
    _file(tmp_path, "budget = 7000\ndepth = 2\n")
    wanted = replace(Policy(), budget=5000, depth=2)
    study = tmp_path / "study.json"
    study.write_bytes(STUDY.read_bytes())
    for command, home in ((("identify", RECORD), "stictionid.verbs.identify.identify"),
                          (("diagnose", study, RECORD), "stictionid.verbs.diagnose.diagnose")):
        with mock.patch(home, side_effect=KeyboardInterrupt) as called, \
                mock.patch("stictionid.cli.diagnose.open_data"):
            out = run(*command, "--policy", "site.toml", "--budget", 5000, cwd=tmp_path)
        assert out.returncode == 130, out.stderr
        assert called.call_args.kwargs["policy"] == wanted


def test_a_method_without_a_search_refuses_a_policy() -> None:
    check_options(Options(), Policy())
    with pytest.raises(UsageError, match="--policy or --budget has no meaning with --method arx"):
        check_options(Options(method="arx"), Policy())


def test_screening_refuses_a_policy(tmp_path: Path) -> None:
    out = run("batch", RECORD, "--level", "screen", "--budget", 50, "-o", tmp_path / "out")
    assert out.returncode == 2 and "--policy or --budget has no meaning with --level screen" in out.stderr


def test_another_policy_is_another_command_in_a_batch() -> None:
    reading = ReadOptions()
    plain = command_for("a.csv", Work(), reading)
    assert "policy" not in plain and "budget" not in plain
    commands = [command_for("a.csv", Work(policy=p, policy_file="site.toml"), reading)
                for p in (Policy(), replace(Policy(), budget=5), replace(Policy(), depth=2))]
    assert len({plain, *commands}) == 4
    assert "--policy site.toml" in commands[1] and "--budget 5 " in commands[1]
    assert command_for("a.csv", Work(policy=Policy(), policy_file="site.toml"), reading) == commands[0]
