"""One family of noise models: its parameters, its filter, its likelihood and its fit to a residual."""
