"""Checks of the signals that were read: codes, spoilt data, compression, findings, and the file of the cleaned loop."""
