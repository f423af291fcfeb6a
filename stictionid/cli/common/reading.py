"""The options of every command that reads a FILE, and their conversion to ReadOptions.

`@reads_file` gives a command all of them: the command takes one argument `reading: ReadOptions` and typer shows the
options. Each option is written once, and a new one reaches all commands.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from ...errors import UsageError
from ...historian.bytes.options import ReadOptions
from .output import say

_PANEL = "Reading"

FileArgument = Annotated[
    str, typer.Argument(metavar="FILE", show_default=False,
                        help="Text, Parquet, workbook or MATLAB file; - for standard input.")
]


def _option(help_text: str, *names: str, metavar: str | None = None) -> Any:
    return typer.Option(*names, help=help_text, metavar=metavar, rich_help_panel=_PANEL, show_default=False)


Sp = Annotated[str | None, _option("Column of the setpoint.", "--sp", metavar="TAG")]
Pv = Annotated[str | None, _option("Column of the process value.", "--pv", metavar="TAG")]
Op = Annotated[str | None, _option("Column of the controller output.", "--op", metavar="TAG")]
Position = Annotated[str | None, _option("Column of a measured valve position.", "--position", metavar="TAG")]
Time = Annotated[str | None, _option("Column of the time (DATE+CLOCK for two).", "--time", metavar="TAG")]
Mode = Annotated[str | None, _option("Column of the controller mode.", "--mode", metavar="TAG")]
Quality = Annotated[str | None, _option("Column of the quality of all values.", "--quality", metavar="TAG")]
Extra = Annotated[
    list[str] | None,
    _option("Further column kept as a measured disturbance; repeatable; '*' for every other tag.", "--extra",
            metavar="TAG"),
]
LoopName = Annotated[
    str | None, _option("Which loop, sheet or struct of a file that holds several.", "--loop", metavar="NAME")
]
Step = Annotated[float | None, _option("Sampling time where there is no time column.", "--step", metavar="SECONDS")]
SpanPv = Annotated[str | None, _option("Range of PV and SP, to scale them to % of span.", "--span-pv", metavar="LO,HI")]
SpanOp = Annotated[str | None, _option("Range of OP (4,20 or 0,1), to scale it to %.", "--span-op", metavar="LO,HI")]
Split = Annotated[str | None, _option("Part of OP that drives this valve (split range).", "--split", metavar="LO,HI")]
ReverseOp = Annotated[bool, _option("OP of 100 closes the valve: use 100 - OP.", "--reverse-op")]
Start = Annotated[
    str | None,
    _option("First time used: a stamp, a clock time, or seconds since the first row.", "--start", metavar="TIME"),
]
End = Annotated[str | None, _option("Last time used.", "--end", metavar="TIME")]
Decimal = Annotated[str | None, _option("Decimal mark, . or ,", "--decimal", metavar="MARK")]
DayFirst = Annotated[
    bool | None, _option("Dates like 03/04/2024 are day first, or month first.", "--dayfirst/--monthfirst")
]
Zone = Annotated[str | None, _option("Time zone of local stamps, for example Europe/Berlin.", "--zone", metavar="NAME")]
TimeFormat = Annotated[
    str | None,
    _option("iso, dmy, mdy, ymd, epoch, excel, excel1904, filetime or seconds.", "--time-format", metavar="WORD"),
]
Encoding = Annotated[
    str | None, _option("Character encoding, for example cp1252 or gbk.", "--encoding", metavar="NAME")
]
Separator = Annotated[str | None, _option("Cell separator: , ; | tab or space.", "--separator", metavar="MARK")]
Header = Annotated[
    int | None,
    typer.Option(
        "--header", min=0, metavar="LINES", help="Lines before the data.", rich_help_panel=_PANEL, show_default=False
    ),
]
Shape = Annotated[str | None, _option("wide, long or paired.", "--shape", metavar="WORD")]
ModeMap = Annotated[
    list[str] | None,
    _option("Meaning of a mode: AUTO, CAS, MAN or OFF; repeatable.", "--mode-map", metavar="MODE=MEANING"),
]
Sentinel = Annotated[
    list[float] | None, _option("Number that means no value; repeatable.", "--sentinel", metavar="VALUE")
]
KeepManual = Annotated[bool, _option("Use samples in manual as well.", "--keep-manual")]
KeepStartup = Annotated[bool, _option("Use samples of a start-up or shut-down as well.", "--keep-startup")]
NoGuess = Annotated[bool, _option("Every assumption is an error.", "--no-guess")]
Profile = Annotated[
    str | None, _option("Site profile written by read --save-profile.", "--profile", metavar="SITE.toml")
]
Limit = Annotated[
    list[str] | None,
    _option("Raise a limit: rows, columns, line, file or unpacked; repeatable.", "--limit", metavar="WHAT=SIZE"),
]

OPTIONS: tuple[tuple[str, Any, Any], ...] = (
    ("sp", Sp, None),
    ("pv", Pv, None),
    ("op", Op, None),
    ("position", Position, None),
    ("time", Time, None),
    ("mode", Mode, None),
    ("quality", Quality, None),
    ("extra", Extra, None),
    ("loop", LoopName, None),
    ("step", Step, None),
    ("span_pv", SpanPv, None),
    ("span_op", SpanOp, None),
    ("split", Split, None),
    ("reverse_op", ReverseOp, False),
    ("start", Start, None),
    ("end", End, None),
    ("decimal", Decimal, None),
    ("dayfirst", DayFirst, None),
    ("zone", Zone, None),
    ("time_format", TimeFormat, None),
    ("encoding", Encoding, None),
    ("separator", Separator, None),
    ("header", Header, None),
    ("shape", Shape, None),
    ("mode_map", ModeMap, None),
    ("sentinel", Sentinel, None),
    ("keep_manual", KeepManual, False),
    ("keep_startup", KeepStartup, False),
    ("no_guess", NoGuess, False),
    ("profile", Profile, None),
    ("limit", Limit, None),
)
_SEPARATORS = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";", "pipe": "|"}


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
    decimal = said["decimal"]
    step = said["step"]
    separator = _SEPARATORS.get(said["separator"] or "", said["separator"])
    return ReadOptions(
        sp=said["sp"],
        pv=said["pv"],
        op=said["op"],
        position=said["position"],
        time=said["time"],
        mode=said["mode"],
        quality=said["quality"],
        extra=tuple(said["extra"] or ()),
        loop=said["loop"],
        step_s=step,
        span_pv=span(said["span_pv"], "--span-pv"),
        span_op=span(said["span_op"], "--span-op"),
        split=span(said["split"], "--split"),
        reverse_op=said["reverse_op"],
        start=said["start"],
        end=said["end"],
        no_guess=said["no_guess"],
        decimal=decimal,
        dayfirst=said["dayfirst"],
        zone=said["zone"],
        time_format=said["time_format"],
        encoding=said["encoding"],
        separator=separator,
        header=said["header"],
        shape=said["shape"],
        mode_map=_map(said["mode_map"] or []),
        sentinels=tuple(said["sentinel"] or ()),
        keep_manual=said["keep_manual"],
        keep_startup=said["keep_startup"],
        profile=said["profile"],
        limit=tuple(said["limit"] or ()),
    )


def span(text: str | None, flag: str) -> tuple[float, float] | None:
    """The two numbers LO,HI of an option; UsageError where they are none, or no range."""
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.replace(";", ",").split(","))
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
    """The Reading of a file; its assumptions and findings go to stderr, one line each."""
    from ...historian import read

    result = read(file, options=reading)
    tell(result, quiet=quiet)
    return result


def tell(result: Any, *, quiet: bool = False) -> None:
    """Print columns, assumptions and findings of a reading on stderr, one line each."""
    roles = ", ".join(f"{role.replace('_', ' ')} = {name}" for role, name in result.columns.items())
    say(f"read {result.file}: {roles}", quiet=quiet)
    for guess in result.assumptions:
        say(f"guessed: {guess}", quiet=quiet)
    for finding in result.findings:
        say(f"{'note' if finding.severity == 'info' else finding.severity}: {finding.statement}", quiet=quiet)
