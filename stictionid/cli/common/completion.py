"""Completion of the command line in bash, zsh and fish: its script shown, or installed for the next terminal.

Names of effects and laws are completed from the files of the catalogues, without the second that loading them takes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ...errors import UsageError
from ...system.registry import names_in

SHELLS = ("bash", "zsh", "fish")
INSTALL, SHOW = "--install-completion", "--show-completion"
PROGRAM = "stictionid"
# The variable by which a shell's script asks this program for completions.
ASKS = "_STICTIONID_COMPLETE"


def effect_names(incomplete: str) -> list[str]:
    """Names of the built-in effects that begin so."""
    return [name for name in names_in("stictionid.effects", "EFFECT") if name.startswith(incomplete)]


def law_names(incomplete: str) -> list[str]:
    """Names of the built-in laws that begin so."""
    return [name for name in names_in("stictionid.laws", "LAW") if name.startswith(incomplete)]


def with_shell(words: Sequence[str]) -> list[str]:
    """The words of the command line; an option of completion without a shell gets that of the terminal."""
    if len(words) == 1 and words[0] in (INSTALL, SHOW):
        return [words[0], _own_shell()]
    return list(words)


def ready() -> None:
    """Prepare the parser where a shell asks it for completions."""
    if ASKS in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()


def script_for(shell: str) -> str:
    """The script that completes this program in a shell; UsageError for one that is not known."""
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    return str(get_completion_script(prog_name=PROGRAM, complete_var=ASKS, shell=_known(shell)))


def install_for(shell: str) -> Path:
    """Install the script for the next terminal; the file that was written."""
    from typer.completion import install  # type: ignore[attr-defined]

    _, place = install(shell=_known(shell), prog_name=PROGRAM, complete_var=ASKS)
    return Path(place)


def _known(shell: str) -> str:
    if shell not in SHELLS:
        raise UsageError(f"there is no completion for the shell {shell!r}", "give one of " + ", ".join(SHELLS))
    return shell


def _own_shell() -> str:
    """The shell that this terminal runs; UsageError where it can't be told."""
    try:
        from shellingham import detect_shell

        found = str(detect_shell()[0])
    except Exception:  # its own error, or one of the system that it looks into
        found = Path(os.environ.get("SHELL", "")).name
    if found not in SHELLS:
        raise UsageError(f"the shell of this terminal is {found or 'not known'}",
                         f"name one: {PROGRAM} {SHOW} " + " or ".join(SHELLS))
    return found
