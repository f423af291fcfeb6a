"""Selection of the model that a record asks for: structures, effects and noise models tried and judged."""
