"""What every step of a diagnosis has: random streams, pace, a cache."""
