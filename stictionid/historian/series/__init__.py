"""Series of one loop in a table: wide, long or paired, assigned to roles."""
