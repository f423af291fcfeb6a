"""Bytes of an export: found, unpacked, decoded, limited."""
