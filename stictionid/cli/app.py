"""The application that commands register on, and the exit code of every outcome."""

from __future__ import annotations

import copy
import os
import sys

import typer

from .._version import __version__
from ..errors import StictionidError
from ..system import interrupts
from .common.completion import INSTALL, PROGRAM, SHELLS, SHOW, install_for, ready, script_for, with_shell
from .common.output import safe

app = typer.Typer(
    name="stictionid", add_completion=False, invoke_without_command=True, pretty_exceptions_enable=False,
    rich_markup_mode=None, context_settings={"help_option_names": ["-h", "--help"]},
    help="Find out from setpoint, controller output and process value whether a control valve sticks, how much, "
         "and what else is wrong with the model of the loop.\n\n"
         "Example: stictionid identify sample_data/foptd.csv -o study.json",
)

_LONGEST_SENTENCE = 900
_CODES = {
    0: "done, whatever the answer", 1: "a rate is worse than chance allows",
    2: "usage, or a file absent or not writable", 3: "content that can't be used", 130: "interrupted",
}
# Undecided with S and J is another outcome: it ends with 0, and with 4 under --strict.
ABSTAINED = "content that can't be used, or a record that holds too little for S and J (abstained)"


def outcome(writes: str, *, json: str = "", abstains: bool = False, strict: str = "", fails: bool = False) -> str:
    """The epilog of a help text; `json` names the result of --json, `strict` says when the exit code is 4."""
    codes = [0, *([1] if fails else []), 2, 3, *([4] if strict else []), 130]
    words = {**_CODES, **({3: ABSTAINED} if abstains else {}), **({4: f"with --strict, {strict}"} if strict else {})}
    parts = [f"Writes: {writes}.", *([f"JSON: {json}."] if json else []),
             "Exit codes: " + "; ".join(f"{code} {words[code]}" for code in codes) + "."]
    return "\n\n".join(parts)


def _version(show: bool) -> None:
    if show:
        print(f"stictionid {__version__}")
        raise typer.Exit()


def _show(shell: str | None) -> None:
    if shell is not None:
        print(script_for(shell))
        raise typer.Exit()


def _install(shell: str | None) -> None:
    if shell is not None:
        print(f"wrote {install_for(shell)}; completion works in the next terminal", file=sys.stderr)
        raise typer.Exit()


_SHELL = f"[{'|'.join(SHELLS)}]"


@app.callback()
def _root(context: typer.Context,
          version: bool = typer.Option(False, "--version", callback=_version, is_eager=True,
                                       help="Print the version and leave."),
          install: str | None = typer.Option(None, INSTALL, metavar=_SHELL, callback=_install, is_eager=True,
                                             help="Install completion for a shell, or for this terminal's."),
          show: str | None = typer.Option(None, SHOW, metavar=_SHELL, callback=_show, is_eager=True,
                                          help="Print the script that completes commands in a shell.")) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


def main() -> None:
    """Entry point: runs a command and turns every outcome into the contract's exit code."""
    # Small matrices on many loops: threads inside BLAS only wait for each other, and would compete with --jobs.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = 0
    try:
        ready()
        words = with_shell(sys.argv[1:])
        result = _with_command(words)(words, prog_name=PROGRAM, standalone_mode=False)
        code = result if isinstance(result, int) else 0
        sys.stdout.flush()
    except StictionidError as error:
        code = _refuse(error.message, error.hint, error.exit_code)
    except KeyboardInterrupt:
        interrupts.over = True
        code = _refuse("interrupted", "", 130)
    except BrokenPipeError:
        _drop_stdout()  # the reader (head, less) has seen enough
    except OSError as error:
        _drop_stdout()
        code = _refuse(f"{error.filename or 'a file'}: {error.strerror or error}", "", 2)
    except Exception as error:
        interrupts.over = True
        ended = interrupts.ended_by()
        code = _other(error) if ended is None else _refuse("interrupted", "", ended)
    sys.exit(code)


def _with_command(words: list[str]) -> typer.Typer:
    """The application with the command that is called; a parser for each of the others takes 20 ms together."""
    called = [c for c in app.registered_commands if c.callback is not None
              and [c.name or c.callback.__name__] == words[:1]]
    if not called:
        return app
    found = copy.copy(app)
    found.registered_commands = called
    return found


def _drop_stdout() -> None:
    """Point stdout elsewhere once it is closed, so that the interpreter's last flush is quiet."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _refuse(message: str, hint: str, code: int) -> int:
    # The option parser repeats the user's input, whatever its length.
    message = message if len(message) <= _LONGEST_SENTENCE else message[:_LONGEST_SENTENCE] + "…"
    print(f"stictionid: {safe(message)}", file=sys.stderr)
    if hint:
        print(f"  {safe(hint)}", file=sys.stderr)
    return code


def _other(error: Exception) -> int:
    """Exit code of usage errors of the option parser, and of defects (exit 1, with the traceback for a report)."""
    if hasattr(error, "exit_code") and hasattr(error, "format_message"):
        context = getattr(error, "ctx", None)
        where = context.command_path if context else "stictionid"
        return _refuse(error.format_message(), f"see {where} --help", 2)
    if type(error).__name__ in ("Exit", "Abort"):
        return int(getattr(error, "exit_code", 130))
    import traceback

    traceback.print_exc()
    print("stictionid: this is a defect in the program; please report it with the lines above", file=sys.stderr)
    return 1
