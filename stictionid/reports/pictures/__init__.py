"""Pictures of a study: numbers to draw, and their renderers."""
