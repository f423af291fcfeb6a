"""Series of one loop from a table (wide, long or paired), assigned to their roles (SP, PV, OP, …)."""
