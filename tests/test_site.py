"""The documentation as a site: it builds, its reference is the program's own, its examples name what is there."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import study_factory
import typer
from commands import HANGS_S

import stictionid.cli
from stictionid.cli.app import app
from stictionid.record.schema import study_schema
from stictionid.record.study import to_json

ROOT = Path(__file__).parent.parent
STUDIES = sorted((Path(__file__).parent / "golden").glob("study_schema_1*.json"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMANDS: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def made() -> Any:
    spec = importlib.util.spec_from_file_location("make_site", ROOT / "docs" / "make_site.py")
    assert spec and spec.loader
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def examples(page: Path) -> list[list[str]]:
    """Words of every stictionid command in the console blocks of a page."""
    blocks = re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    lines = [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ stictionid ")]
    return [shlex.split(re.split(r"\s[;|>#]\s?|;\s", line)[0])[1:] for line in lines]


def test_the_schema_is_one_and_every_study_keeps_it() -> None:
    schema = study_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    made_up = (study_factory.good(240), study_factory.searched(240), study_factory.doubtful(240),
               study_factory.abstained())
    by_hand = replace(made_up[1].study, steps=tuple(replace(step, supported=answer) for step, answer in
                                                    zip(made_up[1].study.steps, (None, False), strict=True)))
    studies = [json.loads(to_json(study)) for study in (by_hand, *(case.study for case in made_up))]
    studies += [json.loads(p.read_text()) for p in STUDIES]
    for study in studies:
        check.validate(study)
    for spoil in ({"schema": "stictionid.study/x"}, {"estimate": {"S": "5"}}, {"adequate": "yes"}, {"steps": {}},
                  {"carried_by": True}, {"swing": {"parts": 1}},
                  {"steps": [{**studies[0]["steps"][0], "supported": "yes"}]}):
        assert list(check.iter_errors({**studies[0], **spoil})), spoil


@pytest.mark.parametrize("page", [p for p in PAGES if examples(p)], ids=lambda page: page.name)
def test_every_console_example_is_a_command_with_options_that_are_there(page: Path) -> None:
    for name, *words in examples(page):
        command = COMMANDS[name]
        context = typer.Context(command, info_name=name)
        _, left, _ = command.make_parser(context).parse_args(list(words))
        assert not [w for w in left if w.startswith("-") and w != "-"], (name, words)


def test_the_reference_has_every_command_option_and_public_function() -> None:
    site = made()
    commands, api = site.commands(), site.api()
    for name, command in COMMANDS.items():
        assert f"\n## {name}\n" in commands
        assert all(option in commands for p in command.params if p.param_type_name == "option" for option in p.opts)
    assert all(f"## stictionid.{name}\n" in api for name in stictionid.__all__)
    catalogue = site.catalogue()
    assert all(f"### {name}\n" in catalogue for name in ("extra-lag", "chen", "auto"))


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """The folder of the site; `.ci/run` has built it and names it in STICTIONID_SITE."""
    if "STICTIONID_SITE" in os.environ:
        return Path(os.environ["STICTIONID_SITE"])
    for name in ("material", "jupytext"):
        pytest.importorskip(name, reason="needs the extra docs")
    done = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path],
                          cwd=ROOT, capture_output=True, text=True, timeout=HANGS_S,
                          env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "http_proxy": "http://127.0.0.1:9"})
    assert done.returncode == 0, done.stderr
    return tmp_path


def test_the_site_builds_without_a_warning_and_fetches_nothing(site: Path) -> None:
    pages = {p.name: p.read_text(encoding="utf-8") for p in site.glob("*.html")}
    assert {"index.html", "commands.html", "study.html", "traps.html", "cannot.html"} <= set(pages)
    for name, text in pages.items():
        assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=.?https?://", text), name
    assert json.loads((site / "study.schema.json").read_text())["title"] == "stictionid study"
    for name in ("one_loop", "plant_month"):
        book = json.loads((site / "notebooks" / f"{name}.ipynb").read_text())
        assert book["nbformat"] == 4 and f'href="{name}.ipynb"' in (site / "notebooks" / f"{name}.html").read_text()
