"""Even time grid of a loop: alignment, step, window, samples that do not count."""
