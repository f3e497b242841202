"""Recordings that are not what scene and schema say are refused before anything is called physics."""
