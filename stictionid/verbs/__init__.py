"""Workflows behind the commands: identify, diagnose, add, agree, screen, selftest, long records."""
