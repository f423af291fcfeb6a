"""Work of a batch: executors, workers, the store of results."""
