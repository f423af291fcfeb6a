"""Bytes of an export and of Arrow columns: opening, unpacking, decoding, limits, and the options of the reader."""
