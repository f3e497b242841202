"""The pages on datasets in a browser: nothing scrolls sideways or overlaps, a path turns, the console is silent."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from candata.datasets import append, create_dataset, open_dataset
from candata.datasets.compare import compare
from candata.datasets.survey import survey
from candata.reports import comparison, inspection
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import Lineage

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--enable-logging=stderr")
#: Turns the first path by a drag, and writes down what can be seen before and after.
DRIVER = """<script>
addEventListener("load", () => {
  const svg = document.querySelector("svg.space"), way = svg && svg.querySelector(".way");
  const before = way && way.getAttribute("d");
  const at = (name, x, y) => svg.dispatchEvent(new PointerEvent(name, { clientX: x, clientY: y, pointerId: 1 }));
  if (svg) {
    svg.setPointerCapture = () => {};
    at("pointerdown", 50, 50); at("pointermove", 90, 60); at("pointerup", 90, 60);
  }
  const boxes = [...document.querySelectorAll(".multiples .chart")].map(c => c.getBoundingClientRect());
  const apart = boxes.every((a, i) => boxes.slice(i + 1).every(b =>
    a.right <= b.left + 1 || b.right <= a.left + 1 || a.bottom <= b.top + 1 || b.bottom <= a.top + 1));
  const turned = svg ? before !== way.getAttribute("d") : null;
  parent.postMessage(JSON.stringify({ turned, apart, charts: boxes.length,
    width: innerWidth, needed: document.documentElement.scrollWidth }), "*");
});
</script></body>"""
FRAME = """<!DOCTYPE html><link rel="icon" href="data:,"><output id="seen"></output><script>
addEventListener("message", e => { document.getElementById("seen").textContent = e.data; });
</script><iframe src="page.html" style="width:{width}px;height:900px;border:0"></iframe>"""


def made(path, seed):
    rng, rows, episodes = np.random.default_rng(seed), 80, []
    names = tuple(f"a_joint_with_quite_a_long_name_{i}" for i in range(5))
    for k in range(6):
        walk = np.cumsum(rng.normal(size=(rows, 3)), axis=0) * 0.01
        arrays = {
            "time_ns": np.arange(rows) * 12_500_000,
            "object_pose": np.c_[walk, np.tile([1, 0, 0, 0], (rows, 1))],
            "joint_position": np.cumsum(rng.normal(size=(rows, 5)), axis=0),
            "action": np.cumsum(rng.normal(size=(rows, 5)), axis=0),
            "fingertip_force": rng.normal(size=(rows, 5, 3)),
            "fingertip_contact": rng.random((rows, 5)) > 0.5,
        }
        meta = EpisodeMeta(id=f"e{k}", source="sim", rate_hz=80.0, joint_names=names, actuator_names=names)
        episodes.append(Episode(meta, arrays))
    append(create_dataset(path), episodes, Lineage(operation="test"))
    return open_dataset(path)


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
@pytest.mark.parametrize("width", [1280, 380])
@pytest.mark.parametrize("kind", ["inspection", "comparison"])
def test_a_page_fits_turns_and_is_silent(tmp_path, kind, width):
    one = made(tmp_path / "one", 1)
    if kind == "inspection":
        text = inspection.page(survey(one))
    else:
        text = comparison.page(compare(one, made(tmp_path / "two", 2)))
    (tmp_path / "page.html").write_text(text.replace("</body>", DRIVER), "utf-8")
    (tmp_path / "frame.html").write_text(FRAME.replace("{width}", str(width)))
    done = subprocess.run(
        [BROWSER, *FLAGS, "--window-size=1400,1000", "--virtual-time-budget=5000",
         f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", (tmp_path / "frame.html").as_uri()],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert re.findall(r".*:CONSOLE.*", done.stderr) == []
    seen = json.loads(html.unescape(re.search(r'<output id="seen">(.*?)</output>', done.stdout, re.S).group(1)))
    assert seen["needed"] <= width == seen["width"], "nothing makes the page scroll sideways"
    assert seen["apart"]
    assert seen["charts"] > 5
    assert seen["turned"] is (True if kind == "inspection" else None)
