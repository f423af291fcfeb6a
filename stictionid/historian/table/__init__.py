"""Tables of an export: text, HTML and Parquet as columns."""
