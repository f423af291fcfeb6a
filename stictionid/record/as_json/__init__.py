"""JSON of a result: its shape, its reading into dataclasses, and the JSON Schema of a study."""
