"""Checks of the signals that were read: spoilt data, compression, findings, the cleaned file."""
