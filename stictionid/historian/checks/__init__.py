"""Checks of the signals that were read: spoilt data, compression, findings, and the file of the cleaned loop."""
