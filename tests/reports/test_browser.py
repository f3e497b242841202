"""The page in a browser: it draws every figure and the console stays silent."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from candata import reports

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-logging=stderr",
    "--virtual-time-budget=5000",
]


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_no_console_error_and_every_figure_drawn(tmp_path, make_report, full_evidence, hand, no_gl, small_pictures):
    path = reports.write_report(make_report(), full_evidence, hand, tmp_path, "effects: []\n")
    done = subprocess.run(
        [
            BROWSER,
            *FLAGS,
            "--virtual-time-budget=5000",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--dump-dom",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert re.findall(r".*:CONSOLE.*", done.stderr) == []
    figures = len(re.findall(r'id="(?:heat|ranking|losses|trace\d+)"', done.stdout))
    drawn = len(re.findall(r'<div id="[a-z0-9]+" style="[^"]*" class="js-plotly-plot"', done.stdout))
    assert drawn == figures == 8
