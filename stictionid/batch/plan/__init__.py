"""Loops of a batch: found in files, folders, datasets and loop lists, one task each."""
