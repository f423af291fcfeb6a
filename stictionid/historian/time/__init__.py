"""Time of an export: stamps, dates as text, zones, order of rows."""
