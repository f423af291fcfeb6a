"""Record of one control loop and the study made of it: signals, segments, oscillation, preconditions, JSON."""
