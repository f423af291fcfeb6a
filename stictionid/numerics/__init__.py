"""Numerical methods without any knowledge of valves: compiled kernels, searches, least squares, autoregression."""
