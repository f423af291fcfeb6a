"""Noise under a fit: autoregression of its residual, prewhitening, tests for whiteness."""
