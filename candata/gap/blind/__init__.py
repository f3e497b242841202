"""Blind cases: hidden causes are drawn and sealed, diagnosed from the data alone, and only then opened and scored."""
