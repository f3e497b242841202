"""Which: sets of effects compete, and what explains most is attributed."""
