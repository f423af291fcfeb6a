"""Plants that nobody tuned to: an independent simulator of control loops, a crossed design, and a table by family."""
