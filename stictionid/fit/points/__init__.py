"""Points of one model: how they move and settle, the record of the best one, and its error on held-out blocks."""
