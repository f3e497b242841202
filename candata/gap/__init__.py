"""The sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""

from candata.gap.diagnosis import diagnose
from candata.gap.verdict.findings import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
