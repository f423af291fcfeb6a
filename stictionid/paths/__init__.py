"""Paths that a valve may have taken: slips drawn at random, weighed by PV, and the model run along one of them."""
