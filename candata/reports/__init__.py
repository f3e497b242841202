"""What people read of a diagnosis: a page, a summary, pictures; nothing here is computed."""

from candata.reports.page import write_report
from candata.reports.render import render_png, render_poses
from candata.reports.terminal import summary
from candata.reports.words import explain

__all__ = ["explain", "render_png", "render_poses", "summary", "write_report"]
