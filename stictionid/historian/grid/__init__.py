"""Even time grid of a loop: alignment of tags, step, window, and masks of samples that do not count."""
