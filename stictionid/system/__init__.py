"""Services around the computation: whole files, signals, safe CSV cells, catalogues, and the count of evaluations."""
