"""Messages for Python: the words of a command line in an error or a finding become names of the Python interface."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from html import escape
from typing import ParamSpec, TypeVar

from ..errors import StictionidError
from ..historian.bytes.options import FLAGS, ROLES

P = ParamSpec("P")
R = TypeVar("R")

# Keywords of Python whose options have another name on the command line; the others only differ in their dashes.
_KEYWORDS = {
    **{FLAGS[option].removeprefix("--"): role for role, option in ROLES.items()}, "step": "step_s", "with": "effects",
    "scan": "scan_s", "all": "everything", "sentinel": "sentinels", "time-constant": "time_constant_s",
    "dead-time": "dead_time_s", "monthfirst": "dayfirst=False",
}
# Commands as functions of `st`; those that have none keep their name.
_FUNCTIONS = {"read": "st.read_loop", "identify": "st.identify", "diagnose": "st.diagnose", "add": "st.add",
              "remove": "st.remove", "compare": "st.compare", "report": "st.report"}
_WHOLE = (
    ("a file written by stictionid identify -o", "a file written by Study.save"),
    ("write one with stictionid read FILE --save-profile", "write one with the command `read` and its profile option"),
    ("after -o", "as the place to write"), ("give -o a name", "give a name"),
)
_COMMAND = re.compile(r"\bstictionid ([a-z]+)\b")
_FLAG = re.compile(r"(?<![\w-])--([a-z][a-z-]*[a-z])(?:[ =](-?\d[\w.]*(?:,-?\d[\w.]*)?)(?![\w.]))?")
_SHORT = re.compile(r"(?<![\w-])-o\b")


def in_python(text: str) -> str:
    """A message with keywords in place of command-line options, and functions in place of commands."""
    for said, instead in _WHOLE:
        text = text.replace(said, instead)
    text = _COMMAND.sub(lambda m: _FUNCTIONS.get(m[1], f"the command {m[1]}"), text)
    return _SHORT.sub("place", _FLAG.sub(_keyword, text))


def _keyword(found: re.Match[str]) -> str:
    name = _KEYWORDS.get(found[1], found[1].replace("-", "_"))
    value = found[2]
    return name if value is None else f"{name}=({value.replace(',', ', ')})" if "," in value else f"{name}={value}"


class Shown:
    """Base of results that show themselves as lines of text, and as HTML in a notebook."""

    def _lines(self) -> list[str]:
        raise NotImplementedError

    def __repr__(self) -> str:
        return "\n".join(self._lines())

    def _repr_html_(self) -> str:
        head, *rest = map(escape, self._lines())
        return f"<p><b>{head}</b></p><ul>{''.join(f'<li>{line}</li>' for line in rest)}</ul>"


def speaking_python(function: Callable[P, R]) -> Callable[P, R]:
    """The function with every StictionidError in the words of Python, its hint as a note below the message."""
    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except StictionidError as error:
            error.message, error.hint = in_python(error.message), in_python(error.hint)
            error.args = (error.message,)
            if error.hint and error.hint not in getattr(error, "__notes__", ()):
                error.add_note(error.hint)
            raise
    return wrapped
