"""What was recorded, on the scene's names and clock, and how noisy it is."""
