"""Loaders: windows of episodes, gathered in batches from a memory-mapped cache."""
