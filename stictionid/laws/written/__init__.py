"""Stiction laws that users write as one step in plain Python."""
