"""The page in a browser: a click on the heat map shows the element's episodes, and the console stays silent."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess

import pytest

from candata import reports

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--enable-logging=stderr")
#: Clicks what lies at the middle of a cell, as a mouse would, and writes down what can be seen before and after.
DRIVER = """<script>
addEventListener("load", () => {
  const seen = () => [...document.querySelectorAll(".panel")].filter(p => p.getBoundingClientRect().height > 0)
    .map(p => ({ element: p.dataset.element, dots: p.querySelectorAll(".dots.before path").length,
      courses: p.querySelectorAll(".course .line.recorded").length }));
  const before = seen();
  const row = document.querySelector('[data-shows="fingertip_force index_tip"]');
  row.scrollIntoView({ block: "center" });
  const box = row.querySelector("td:last-child").getBoundingClientRect();
  document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).click();
  parent.postMessage(JSON.stringify({ before, after: seen(), pressed: row.querySelector("button").ariaPressed,
    width: innerWidth, needed: document.documentElement.scrollWidth }), "*");
});
</script></body>"""
#: Holds the page at a width that the browser's own window refuses, and keeps what the driver wrote down.
FRAME = """<!DOCTYPE html><link rel="icon" href="data:,"><output id="seen"></output><script>
addEventListener("message", e => { document.getElementById("seen").textContent = e.data; });
</script><iframe src="report.html" style="width:{width}px;height:900px;border:0"></iframe>"""


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
@pytest.mark.parametrize("width", [1280, 380])
def test_a_click_on_the_heat_map_shows_the_elements_episodes(
    tmp_path, make_report, full_evidence, hand, no_gl, small_pictures, width
):
    path = reports.write_report(make_report(), full_evidence, hand, tmp_path, "effects: []\n")
    path.write_text(path.read_text("utf-8").replace("</body>", DRIVER), "utf-8")
    (tmp_path / "frame.html").write_text(FRAME.replace("{width}", str(width)))
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    done = subprocess.run(
        [BROWSER, *FLAGS, "--window-size=1400,1000", "--virtual-time-budget=5000", profile, "--dump-dom",
         (tmp_path / "frame.html").as_uri()],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert re.findall(r".*:CONSOLE.*", done.stderr) == []
    seen = json.loads(html.unescape(re.search(r'<output id="seen">(.*?)</output>', done.stdout, re.S).group(1)))
    assert seen["before"] == [{"element": "joint_position index2", "dots": 24, "courses": 3}]
    assert seen["after"] == [{"element": "fingertip_force index_tip", "dots": 24, "courses": 3}]
    assert seen["pressed"] == "true"
    assert seen["width"] == width
    assert seen["needed"] <= width, "nothing makes the page scroll sideways"
