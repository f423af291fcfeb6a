"""Verdict on the valve: sticking or not, other causes of the cycle, severity, law ranking, S and J from a position."""
