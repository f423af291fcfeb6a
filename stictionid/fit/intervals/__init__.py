"""Intervals of S, J and the process from the likelihood of a fit."""
