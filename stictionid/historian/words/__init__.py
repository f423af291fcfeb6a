"""Vocabulary of exports: roles, units, modes, quality codes, system states, numbers as text, and that of findings."""
