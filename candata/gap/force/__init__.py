"""Causes in no library: a residual force, where it acts and what it depends on."""
