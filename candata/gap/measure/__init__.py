"""How large a gap is, in floors, and in which channels and phases it lies."""
