"""The options of every command that reads a FILE, made from their declaration, and their conversion to ReadOptions.

`@reads_file` gives a command all of them: the command takes one argument `reading: ReadOptions` and typer shows the
options.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from ...errors import UsageError
from ...historian.bytes.options import FLAGS, KINDS, ReadOptions, span_of
from .output import say

FileArgument = Annotated[
    str, typer.Argument(metavar="FILE", show_default=False,
                        help="Text, Parquet, workbook or MATLAB file; - for standard input.")
]
# Type of an option on the command line by the type of its field; others are text.
_TYPED: dict[str, Any] = {
    "float | None": float | None, "int | None": int | None, "bool": bool, "bool | None": bool | None,
    "tuple[str, ...]": list[str] | None, "tuple[float, ...]": list[float] | None, "dict[str, str]": list[str] | None,
}
_SEPARATORS = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";", "pipe": "|"}


def _shown(field: dataclasses.Field[Any]) -> tuple[str, Any, Any]:
    """Name, annotation and default of an option."""
    option = typer.Option(FLAGS[field.name], help=field.metadata["help"], metavar=field.metadata["metavar"],
                          min=0 if field.name == "header" else None, rich_help_panel="Reading", show_default=False)
    kind = KINDS[field.name]
    return field.name, Annotated[_TYPED.get(kind, str | None), option], False if kind == "bool" else None


OPTIONS = tuple(_shown(field) for field in dataclasses.fields(ReadOptions) if "help" in field.metadata)


def reads_file(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command every reading option; it receives them as one argument `reading: ReadOptions`."""
    own = inspect.signature(command, eval_str=True)
    keyword = inspect.Parameter.KEYWORD_ONLY
    mine = [p for p in own.parameters.values() if p.name != "reading"]
    shared = [inspect.Parameter(name, keyword, default=default, annotation=kind) for name, kind, default in OPTIONS]

    @functools.wraps(command)
    def wrapper(*args: Any, **values: Any) -> Any:
        said = {name: values.pop(name) for name, _, _ in OPTIONS}
        return command(*args, **values, reading=collect(said))

    parameters = [p.replace(kind=keyword) for p in mine] + shared
    wrapper.__signature__ = inspect.Signature(parameters, return_annotation=own.return_annotation)  # type: ignore[attr-defined]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    return wrapper


def collect(said: dict[str, Any]) -> ReadOptions:
    """The values of the options as ReadOptions; UsageError for one that cannot be read."""
    return ReadOptions(**{name: _read(name, value) for name, value in said.items()})


def _read(name: str, value: Any) -> Any:
    """The value of one option in the type of its field."""
    kind = KINDS[name]
    if kind.startswith("dict"):
        return _map(value or [])
    if kind.endswith("...]"):
        return tuple(value or ())
    if name == "separator":
        return _SEPARATORS.get(value or "", value)
    return span(value, FLAGS[name]) if kind.startswith("tuple") and value is not None else value


def span(text: str, flag: str) -> tuple[float, float]:
    """The two numbers LO,HI of an option; UsageError where they are none, or no range."""
    try:
        low, high = span_of(text)
    except ValueError:
        raise UsageError(
            f"{flag} {text!r} is no range", f"give two numbers with a comma, for example {flag} 0,100"
        ) from None
    if not low < high < float("inf"):
        raise UsageError(
            f"{flag} {text!r} is no range: its first number is not below its second", f"for example {flag} 0,100"
        )
    return low, high


def _map(pairs: list[str]) -> dict[str, str]:
    found = {}
    for pair in pairs:
        word, mark, meaning = pair.partition("=")
        if not mark or not word.strip():
            raise UsageError(
                f"--mode-map {pair!r} is not MODE=MEANING", "for example --mode-map 1=AUTO --mode-map 0=MAN"
            )
        found[word.strip()] = meaning.strip().upper()
    return found


def read_file(file: str, reading: ReadOptions, *, quiet: bool = False) -> Any:
    """The Reading of a file; its columns, assumptions and findings go to stderr, one line each."""
    from ...historian import read

    result = read(file, options=reading)
    roles = ", ".join(f"{role.replace('_', ' ')} = {name}" for role, name in result.columns.items())
    say(f"read {result.file}: {roles}", quiet=quiet)
    for guess in result.assumptions:
        say(f"guessed: {guess}", quiet=quiet)
    for finding in result.findings:
        say(f"{'note' if finding.severity == 'info' else finding.severity}: {finding.statement}", quiet=quiet)
    return result
