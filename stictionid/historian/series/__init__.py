"""Series of one loop, one for each role (SP, PV, OP, …), from a wide, long or paired table."""
