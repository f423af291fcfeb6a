"""Model of a loop: law, effects, process and noise in physical order; its simulation and its stored description."""
