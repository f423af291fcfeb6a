"""Size limits of an export (rows, columns, bytes), and the option that raises them."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass

from ...errors import DataError, UsageError


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of `rows` and `columns` of a table; of bytes of a `line`, of a `file`, and of content held `unpacked`.

    30 million rows are one second over a year and take about 4 GB. 10,000 columns of 100 characters are a line of
    1 MiB. UTF-8 text is read in pieces up to the file limit. Content that must be held whole (gzip, zip, standard
    input, other encodings, the wanted columns of Parquet) stays below `unpacked`.
    """

    rows: int = 30_000_000
    columns: int = 10_000
    line: int = 1 << 20
    file: int = 64 << 30
    unpacked: int = 2 << 30

    def check(self, what: str, value: int, name: str, advice: str = "") -> None:
        """DataError where `value` is above the limit `what`, with the option that raises it."""
        limit = getattr(self, what)
        if value > limit:
            hint = f"raise it with --limit {what}={_suggest(what, value)}" + (f", or {advice}" if advice else "")
            raise DataError(f"{name} has {_words(what, value)}, more than the limit of {_words(what, limit)}", hint)


NAMES = tuple(f.name for f in dataclasses.fields(Limits))
_SIZES = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 1 << 10, "mi": 1 << 20, "gi": 1 << 30,
          "ti": 1 << 40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?(?:e\d{1,2})?)\s*([kmgt]i?)?b?", re.IGNORECASE | re.ASCII)


def limits_from(said: tuple[str, ...]) -> Limits:
    """Limits from the values of --limit, for example ("rows=1e8", "file=100GB"). UsageError for anything else."""
    changes = {}
    for pair in said:
        what, _, size = pair.partition("=")
        match = _SIZE.fullmatch(size.strip())
        if what.strip() not in NAMES or match is None:
            raise UsageError(f"--limit {pair!r} is not WHAT=SIZE",
                             f"WHAT is one of {', '.join(NAMES)}; for example --limit rows=1e8 or --limit file=100GB")
        value = float(match.group(1)) * _SIZES[(match.group(2) or "").lower()]
        if not 1 <= value < 1e18:
            raise UsageError(f"--limit {pair!r} is out of range", "give 1 to 1e18")
        changes[what.strip()] = round(value)
    return Limits(**changes)


def _words(what: str, value: int) -> str:
    if what in ("rows", "columns"):
        return f"{value:,} {what}"
    size = next((f"{value / 10**p:.3g} {u}" for p, u in ((9, "GB"), (6, "MB")) if value >= 10**p), f"{value:,} bytes")
    return {"line": f"a line of {size}", "file": size, "unpacked": f"{size} unpacked"}[what]


def _suggest(what: str, value: int) -> str:
    if what in ("rows", "columns"):
        return f"{value}"
    return f"{-(-value // 10**9)}GB" if value >= 10**9 else f"{-(-value // 10**6)}MB"
