"""What people read of a diagnosis: a page, a summary, pictures; nothing here is computed."""

from candata.reports.files import effects_text, write_diagnosis
from candata.reports.page import write_report
from candata.reports.render import render_png, render_poses
from candata.reports.terminal import summary
from candata.reports.words import explain

__all__ = [
    "effects_text",
    "explain",
    "render_png",
    "render_poses",
    "summary",
    "write_diagnosis",
    "write_report",
]
