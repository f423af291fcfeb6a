"""The version number, alone in a file so that packaging reads it without importing anything."""

__version__ = "1.0.0rc1"
