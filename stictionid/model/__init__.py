"""A stiction law, effects, a process and noise in physical order: specified, run on a record, simulated, stored."""
