"""Generators of starting points for a fit, named by the part of the model that they serve."""
