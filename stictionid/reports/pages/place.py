"""Place of a page and of the pictures beside it: checked before the work, and written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ...errors import UsageError
from ...system.files import ensure_writable, write_whole
from ..pictures.figures import PNG_KIND, figure_bytes
from ..pictures.picture import Picture
from ..pictures.svg import SVG_KIND

FIGURES = {"svg": SVG_KIND, "png": PNG_KIND}


def check_place(what: str, out: Path, kinds: Mapping[str, bytes], choice: str, *, figures: str = "svg",
                force: bool = False) -> bytes:
    """First bytes of the page at `out`; UsageError where nothing can be written there.

    `kinds` has them by ending, and `choice` says the endings in words. `figures` is the kind of the pictures.
    """
    kind = kinds.get(out.suffix.lower())
    if kind is None:
        raise UsageError(f"{out.suffix or 'no extension'!r} is no kind of {what}", f"give -o a name ending in {choice}")
    if figures not in FIGURES:
        raise UsageError(f"'{figures}' is no kind of figure", "give --figures svg or --figures png")
    ensure_writable(out, force=force, kind=kind)
    return kind


def beside(out: Path, key: str, figures: str = "svg") -> Path:
    """The place of one picture of the page at `out`."""
    return out.with_name(f"{out.stem}-{key.replace('_', '-')}.{figures}")


def write_page(out: Path, text: str, drawn: Mapping[Path, Picture], *, kind: bytes, figures: str = "svg",
               force: bool = False) -> list[Path]:
    """Write the pictures, then the page; what is new goes again where one of them can't be written."""
    files = {path: figure_bytes(picture, figures) for path, picture in drawn.items()}
    for path in files:
        ensure_writable(path, force=force, kind=FIGURES[figures])
    written: list[Path] = []
    try:
        for path, content in files.items():
            new = not path.exists()
            write_whole(path, content, force=force, kind=FIGURES[figures])
            written += [path] if new else []
        write_whole(out, text, force=force, kind=kind)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise
    return [*files, out]
