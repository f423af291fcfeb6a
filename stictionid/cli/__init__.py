"""The command line, one file per command: a client of the library, and the only room that prints or exits."""

# Commands register themselves on `app` when they are imported.
from . import agree, batch, compare, diagnose, effects, identify, laws, range, read, report, selftest, simulate, study
from .app import main

__all__ = ["agree", "batch", "compare", "diagnose", "effects", "identify", "laws", "main", "range", "read", "report",
           "selftest", "simulate", "study"]
