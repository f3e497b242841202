"""The sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""

from candata.gap.conclusion import Diagnosis
from candata.gap.diagnosis import diagnose

__all__ = ["Diagnosis", "diagnose"]
