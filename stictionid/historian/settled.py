"""Reading options made complete before the file is opened: profile applied, values checked."""

from __future__ import annotations

from ..errors import UsageError
from .bytes.options import ReadOptions
from .bytes.source import limits_from
from .grid.window import check_bound
from .time.clock import check_zone
from .time.stamps import FORMATS
from .words.cells import shown
from .words.modes import check_map
from .words.quality import KINDS
from .words.units import check_span

MIN_STEP_S, MAX_STEP_S = 1e-6, 1e7
"""Limits of --step, seconds: a microsecond to 116 days."""
SHAPES = ("wide", "long", "paired")


def settled(options: ReadOptions | None) -> ReadOptions:
    """The options with their profile written out. UsageError for a value with which no file could be read."""
    options = options or ReadOptions()
    if options.profile is not None:
        from .profile import with_profile

        options = with_profile(options)
    for span, flag in ((options.span_pv, "--span-pv"), (options.span_op, "--span-op"), (options.split, "--split")):
        check_span(span, flag)
    check_map(options.mode_map)
    limits_from(options.limit)
    for text, flag in ((options.start, "--start"), (options.end, "--end")):
        if text is not None:
            check_bound(text, flag)
    if options.zone is not None:
        check_zone(options.zone)
    try:
        b"0".decode(options.encoding or "ascii", "replace")
    except (LookupError, ValueError):
        raise UsageError(f"--encoding {shown(options.encoding)} is not a character encoding",
                         "use for example utf-8, cp1252, cp1251, gbk, shift_jis or utf-16") from None
    for value, flag, known in ((options.shape, "--shape", SHAPES), (options.time_format, "--time-format", FORMATS),
                               (options.quality_kind, "quality kind", KINDS)):
        if value is not None and value not in known:
            raise UsageError(f"{flag} {shown(value)} is unknown", f"one of {', '.join(known)}")
    _check_layout(options)
    return options


def _check_layout(options: ReadOptions) -> None:
    step, header, separator = options.step_s, options.header, options.separator
    if step is not None and not MIN_STEP_S <= step <= MAX_STEP_S:
        raise UsageError(f"--step {step:g} is not between {MIN_STEP_S:g} and {MAX_STEP_S:g} s", "for example --step 1")
    if header is not None and header < 0:
        raise UsageError(f"--header {header} is below 0", "give the number of lines before the data")
    if separator is not None and (len(separator) != 1 or not separator.isascii() or separator in "\r\n\"\0"):
        raise UsageError(f"--separator {shown(separator)} is not one plain character", "use , ; | tab or space")
    if options.decimal not in (None, ".", ","):
        raise UsageError(f"--decimal {shown(options.decimal)} is no decimal mark", "use . or ,")
    if options.decimal == "," and separator == ",":
        raise UsageError("--decimal , and --separator , can't both be", "export it with semicolons, tabs or quotes")
