"""Bytes of an export: opening, unpacking, decoding, limits, and the options of the reader."""
