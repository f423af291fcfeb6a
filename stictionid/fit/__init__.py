"""One model fitted to one record: starts, descent, effects, noise, intervals, cross-validation."""
