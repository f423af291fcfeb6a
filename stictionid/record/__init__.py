"""One loop's record and the study made of it: signals, stretches, oscillation, preconditions, JSON."""
