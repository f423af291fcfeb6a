"""Table of an export as columns, from text, HTML, Parquet, workbook or MATLAB file; content of each column."""
