"""Pages of a study: markdown, HTML and JSON, each from the same facts."""
