"""Services of the operating system and of Python: whole files, signals, safe cells, catalogues that are folders."""
