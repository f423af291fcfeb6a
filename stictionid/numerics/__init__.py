"""Numerical methods that know nothing of valves: kernels, searches, least squares, autoregression."""
