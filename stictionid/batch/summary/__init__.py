"""Summary of a batch: one row per loop, ranked, as table and page."""
