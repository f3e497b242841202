"""The sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""

from candata.gap.diagnosis import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
