"""Pages of the documentation site that come from the code: a hook of mkdocs (see mkdocs.yml).

README.md and CONTRIBUTING.md join the site; commands, schema, Python functions and the catalogues are written from
what the package says of itself. Run: mkdocs build --strict
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import re
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# An annotation in quotes, as postponed ones are shown.
_ANNOTATION = re.compile(r"(: |-> )'([^']*)'")
# Links to files of the repository that are no pages of the site.
_OUTSIDE = re.compile(r"\[([^\]]+)\]\((?!https?:|study\.schema)[^)#]+\.(?:json|py|txt)\)")


def readme() -> str:
    """README.md, its links as seen from docs/."""
    return _page((ROOT / "README.md").read_text(encoding="utf-8"))


def contributing() -> str:
    """CONTRIBUTING.md, its links as seen from docs/."""
    return _page((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))


def _page(text: str) -> str:
    text = text.replace("](docs/", "](").replace("](../README.md", "](index.md")
    return _OUTSIDE.sub(r"\1", text.replace("](CONTRIBUTING.md", "](contributing.md"))


def commands() -> str:
    """Every command with its help, arguments, options, files, JSON and exit codes."""
    import typer

    import stictionid.cli
    from stictionid.cli.app import app

    assert stictionid.cli.__all__  # its commands have registered themselves
    group = typer.main.get_command(app)
    out = ["# Commands", "", "Written from the program's own help; `stictionid COMMAND --help` prints the same.", ""]
    for name, command in sorted(group.commands.items()):  # type: ignore[attr-defined]
        context = typer.Context(command, info_name=f"stictionid {name}")
        text, _, example = inspect.cleandoc(command.help or "").partition("Example: ")
        out += [f"## {name}", "", text.strip(), ""]
        if example:
            out += ["```console", f"$ {' '.join(example.split())}", "```", ""]
        rows = [r for p in command.params if (r := _option(p, context))]
        out += _table(("argument or option", "meaning"), rows)
        out += [part for line in (command.epilog or "").split("\n\n") for part in (line, "")]
    return "\n".join(out)


def _option(p: Any, context: Any) -> tuple[str, str] | None:
    if p.param_type_name == "argument":
        return f"`{p.metavar or p.name.upper()}`", _flat(getattr(p, "help", "") or "")
    found = p.get_help_record(context)
    return (f"`{_flat(found[0])}`", _flat(found[1])) if found else None


def study() -> str:
    """The fields of study.json by object, and a link to the schema."""
    from stictionid.record.schema import study_schema

    parts = study_schema()["$defs"]
    out = ["# study.json", "", "The result of `identify`, `diagnose`, `add`, `remove` and `study`, and of `--json`. "
           "The same as JSON Schema: [study.schema.json](study.schema.json). Fields are added, never renamed. "
           "A number that does not exist is null.", ""]
    for name in sorted(parts, key=lambda n: n != "Study"):
        part = parts[name]
        out += [f"## {name}", "", part["description"].replace("<", "&lt;"), ""]
        out += _table(("field", "type"), [(f"`{field}`", _kind(kind)) for field, kind in part["properties"].items()])
    return "\n".join(out)


def _kind(kind: dict[str, Any]) -> str:
    if "$ref" in kind:
        name = kind["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in kind:
        return " or ".join(_kind(k) for k in kind["anyOf"])
    if kind.get("type") == "array":
        return "list of " + _kind(kind["items"]) if "items" in kind else f"{kind['minItems']} values"
    if kind.get("type") == "object":
        return "object of " + _kind(kind["additionalProperties"])
    said = kind.get("type", f"`{kind['const']}`" if "const" in kind else "anything")
    return " or ".join(said) if isinstance(said, list) else said


def schema() -> str:
    """The JSON Schema of a study."""
    from stictionid.record.schema import study_schema

    return json.dumps(study_schema(), indent=1) + "\n"


def api() -> str:
    """Signature and docstring of every public function, and of the members of a study."""
    import stictionid

    out = ["# Python", "", "Written from the docstrings. [Work in a notebook](python.md) shows how they go together.",
           ""]
    for name in sorted(stictionid.__all__, key=str.casefold):
        thing = getattr(stictionid, name)
        out += _described(f"stictionid.{name}", thing, 2)
        if inspect.isclass(thing):
            for member, value in sorted(vars(thing).items()):
                known = inspect.isfunction(value) or isinstance(value, (classmethod, property))
                if known and not member.startswith("_"):
                    out += _described(f"{name}.{member}", value, 3)
    return "\n".join(out)


def _described(name: str, thing: Any, level: int) -> list[str]:
    plain = thing.fget if isinstance(thing, property) else getattr(thing, "__func__", thing)
    shown = "" if isinstance(thing, property) or inspect.isclass(plain) else \
        _ANNOTATION.sub(r"\1\2", str(inspect.signature(plain)))
    text = inspect.getdoc(plain) or ""
    code = ["```python", f"{name}{shown}", "```", ""] if shown else []
    return [f"{'#' * level} {name}", "", *code, text.replace("<", "&lt;"), ""]


def catalogue() -> str:
    """Effects, laws and methods with equation, parameters and source."""
    from stictionid import effects, laws, methods

    out = ["# Effects, laws, methods", "", "Written from the catalogues; `stictionid effects NAME` and `stictionid "
           "laws NAME` print the same and draw pictures.", "", "## Effects", ""]
    for name, effect in effects.catalogue().items():
        out += _entry(name, effect)
        out += _table(("parameter", "unit", "neutral", "meaning"),
                      [(f"`{p.name}`", p.unit, f"{p.neutral:g}", p.meaning) for p in effect.parameters])
        out += [f"Shown by: {effect.settled_by}.", ""]
    out += ["## Laws", ""]
    for name, law in laws.catalogue().items():
        out += [*_entry(name, law), f"Can't represent: {law.cannot}.", ""]
    out += ["## Methods", ""]
    for name, method in methods.catalogue().items():
        out += [*_entry(name, method), f"Can't see: {method.cannot}.", ""]
    return "\n".join(out)


def _entry(name: str, thing: Any) -> list[str]:
    return [f"### {name}", "", f"{_sentence(thing.summary)}", "", "```text", thing.equation, "```", "",
            f"Source: {thing.source}.", ""]


def cannot() -> str:
    """The written page on limits, and the pairs of effects that only a test tells apart."""
    from stictionid.effects import catalogue as known

    pairs: dict[tuple[str, str], str] = {}
    for name, effect in known().items():
        for rival in effect.confused_with:
            other = known()[rival].told_apart.get(name, "") if rival in known() else ""
            settled = effect.told_apart.get(rival) or other or effect.settled_by
            pairs.setdefault((min(name, rival), max(name, rival)), settled)
    rows = [(f"`{a}`, `{b}`", said) for (a, b), said in sorted(pairs.items())]
    page = (ROOT / "docs" / "cannot.md").read_text(encoding="utf-8")
    return page + "\n" + "\n".join(_table(("alike in u and y", "what tells"), rows))


def notebooks() -> dict[str, Callable[[], str]]:
    """The notebooks of docs/notebooks/ to be downloaded, as Jupyter stores them."""
    spec = importlib.util.spec_from_file_location("make_notebooks", ROOT / "docs" / "make_notebooks.py")
    assert spec and spec.loader
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return {f"notebooks/{name}.ipynb": partial(made.as_ipynb, name) for name in made.names()}


def _table(heads: Iterable[str], rows: Iterable[tuple[str, ...]]) -> list[str]:
    rows, heads = list(rows), list(heads)
    if not rows:
        return []
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines] + [""]


def _cell(text: str) -> str:
    """A cell of a table: a bar outside code would end it."""
    return _flat(text) if text.startswith("`") else _flat(text).replace("|", "\\|").replace("<", "&lt;")


def _flat(text: str) -> str:
    return " ".join(text.split())


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


# Pages that are no files of docs/, and the one that is made of a file and the catalogue.
PAGES: dict[str, Callable[[], str]] = {
    "index.md": readme, "contributing.md": contributing, "commands.md": commands, "study.md": study,
    "study.schema.json": schema, "api.md": api, "catalogue.md": catalogue}


def on_files(files: Any, config: Any) -> Any:
    """Add the pages to those of docs/ (called by mkdocs)."""
    from mkdocs.structure.files import File

    # Here, not above: mkdocs takes back what a hook does to the path while it is loaded.
    sys.path.insert(0, str(ROOT))
    for name, make in {**PAGES, **notebooks()}.items():
        files.append(File.generated(config, name, content=make()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links of a page of docs/ as the site has them (called by mkdocs)."""
    return cannot() if page.file.src_uri == "cannot.md" else _page(markdown)
