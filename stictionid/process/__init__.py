"""Process dynamics from valve position to process value, and the controller output between two samples."""
