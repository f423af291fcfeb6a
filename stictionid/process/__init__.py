"""Linear dynamics from valve position to process value, and the command between two samples."""
