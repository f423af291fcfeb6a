"""Table of an export as columns, from text, HTML or Parquet."""
