"""Words of an export: roles, units, modes, quality, states, numbers as text."""
