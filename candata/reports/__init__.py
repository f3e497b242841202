"""What people read of a diagnosis: a page, a summary, pictures; nothing here is computed."""

from candata.reports.advice import ReportContext
from candata.reports.files import effects_text, report_context, write_diagnosis
from candata.reports.outcome import explain
from candata.reports.page import write_report
from candata.reports.render import render_png, render_poses
from candata.reports.terminal import summary

__all__ = [
    "ReportContext",
    "effects_text",
    "explain",
    "render_png",
    "render_poses",
    "report_context",
    "summary",
    "write_diagnosis",
    "write_report",
]
