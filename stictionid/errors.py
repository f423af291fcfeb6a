"""Errors that a user can cause: one sentence with the value and the limit, and a hint with the next thing to type.

Each class holds the exit code of the command line (the contract's table). The shell and a notebook see the same error.
"""


class StictionidError(Exception):
    """A refusal in one sentence; `hint` says what to do next and `exit_code` what the shell sees."""

    exit_code = 2

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class UsageError(StictionidError):
    """A command, option, name or value that does not exist or is out of range; files absent or not writable."""

    exit_code = 2


class DataError(StictionidError):
    """The content of a file cannot be used: unreadable, empty, changed, or without what was asked for."""

    exit_code = 3


class ModelError(StictionidError):
    """A law, effect or process got parameters outside its validity."""

    exit_code = 2


class CannotTell(StictionidError):
    """The record was read but does not hold the answer (abstention); the message is the reason in the verdict.

    `code` is a stable word for scripts, for example "constant-output" or "too-few-cycles".
    """

    exit_code = 3

    def __init__(self, message: str, hint: str = "", *, code: str = "cannot-tell") -> None:
        super().__init__(message, hint)
        self.code = code
