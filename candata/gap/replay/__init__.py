"""Where a replay starts, what it plays, and what it leaves of the recordings."""
