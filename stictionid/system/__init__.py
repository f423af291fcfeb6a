"""Services around the computation: whole-file writes, signals, safe CSV cells, and the registry of catalogues."""
