"""Atomic writing of files (whole or not at all), bounded reading of small ones, and the SHA-256 of a file."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import tempfile
from pathlib import Path

from ..errors import DataError, UsageError

MOST_TEXT_BYTES = 64 << 20
"""Largest study, loop list or profile that is read, bytes; what this program writes stays far below."""


def sha256_of(path: str | Path) -> str:
    """SHA-256 of a file's bytes, as hex. UsageError for a device or a pipe, which may have no end."""
    if _is_special(Path(path)):
        raise UsageError(f"{path} is a device or a pipe, and its end can't be known", "give a file")
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def text_of(path: str | Path, what: str, *, hint: str, encoding: str = "utf-8") -> str:
    """The text of a small file, called `what` in errors: UsageError where it is absent, DataError where it is no text.

    Never more than `MOST_TEXT_BYTES` of it are read, whatever the path leads to.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_TEXT_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{what} {path} can't be read: {reason}".lstrip(), hint) from None
    if len(data) > MOST_TEXT_BYTES:
        raise DataError(f"{what} {path} is larger than {MOST_TEXT_BYTES >> 20} MiB".lstrip(), hint)
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        raise DataError(f"{what} {path} is not UTF-8 text".lstrip(), hint) from None


def write_whole(path: str | Path, content: bytes | str, *, force: bool = False, kind: bytes | None = None) -> None:
    """Write `content` to a temporary file beside `path` and rename it: the file is whole or absent.

    An existing file is replaced only when it begins with `kind` (the same kind of file; None: never replace)
    or with `force`. Text is UTF-8. UsageError (exit 2) where the place can't be written or the disk is full.
    """
    path = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    ensure_writable(path, force=force, kind=kind)
    if _is_special(path):
        _write_through(path, data)
        return
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:80]}.", suffix=".part", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def ensure_writable(path: str | Path, *, force: bool = False, kind: bytes | None = None) -> None:
    """Refuse a place that can't take the file, before the work that would fill it is done."""
    path = Path(path)
    if path.is_dir():
        raise UsageError(f"{path} is a folder", "give a file name after -o")
    if _is_special(path):
        if not os.access(path, os.W_OK):
            raise UsageError(f"{path} can't be written", "choose another place with -o")
        return
    if not path.parent.is_dir():
        raise UsageError(f"the folder {path.parent} does not exist", f"mkdir -p '{path.parent}', or choose another -o")
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"the folder {path.parent} can't be written", "choose another place with -o")
    if path.exists() and not force:
        try:
            with open(path, "rb") as file:
                start = file.read(len(kind) if kind else 1)
        except OSError as error:
            raise unwritable(path, error) from None
        if start and (kind is None or not start.startswith(kind)):
            raise UsageError(f"{path} exists and is another kind of file", "choose another -o, or add --force")


def keep_apart(output: str | Path, *inputs: str | Path, what: str = "the export") -> None:
    """UsageError where the output is one of the inputs it is made from; --force does not permit that either."""
    for given in inputs:
        try:
            same = os.path.samefile(output, given)
        except (OSError, ValueError):
            continue
        if same and not _is_special(Path(output)):
            raise UsageError(f"-o {output} is {what} itself", f"choose another -o; {what} stays as it is")


def locked(path: str | Path, *, wait: bool = True) -> int | None:
    """A handle that holds the lock on a file until it is closed; None where files can't be locked.

    BlockingIOError where another process has it and this one does not wait.
    """
    handle = None
    try:
        import fcntl

        Path(path).parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except (ImportError, OSError) as error:
        if handle is not None:
            os.close(handle)
        if isinstance(error, BlockingIOError):
            raise
        return None
    return handle


def _is_special(path: Path) -> bool:
    """True for a path to a device or a pipe (/dev/null, /dev/stdout), which a file must never replace."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _write_through(path: Path, data: bytes) -> None:
    try:
        with open(path, "wb") as file:
            file.write(data)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise unwritable(path, error) from None


def unwritable(path: str | Path, error: OSError) -> UsageError:
    """The sentence for a failed write."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return UsageError(f"no room left while writing {path}", "free some space; nothing was left half-written")
    return UsageError(f"{path} can't be written: {error.strerror or error}", "choose another place with -o")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
