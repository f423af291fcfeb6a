"""Pages of a study: markdown, HTML, JSON and terminal text, each from the same facts."""
