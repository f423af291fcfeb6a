"""Pages of a study as markdown, HTML and JSON, of two studies side by side, and of an effect in the atlas."""
