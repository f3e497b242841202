"""A plausible diagnosis of a toy hand, for the tests of the report."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from candata.gap.measure.symptoms import HeatMap
from candata.gap.verdict.figures import (
    Collinearity,
    Course,
    Element,
    Elements,
    EpisodeLosses,
    Evidence,
    Example,
    Range,
    Trace,
)
from candata.reports import filmstrip
from candata.schema.report import Report

PHASES = ("free", "onset", "sustained", "slip", "release")
FINGERS = ("thumb", "index", "mid", "ring", "pinky")


def finger(name: str, angle: float) -> str:
    """One finger with two joints that curls towards the palm's axis."""
    x, y, c, s = 0.055 * np.cos(angle), 0.055 * np.sin(angle), np.cos(angle), np.sin(angle)
    axis = f"{-s:.3f} {c:.3f} 0"
    return f"""<body name="{name}1" pos="{x:.4f} {y:.4f} 0"><joint name="{name}1" axis="{axis}"/>
      <geom type="capsule" fromto="0 0 0 {0.02 * c:.4f} {0.02 * s:.4f} -.07" size=".011"
        rgba=".87 .85 .81 1"/>
      <body name="{name}2" pos="{0.02 * c:.4f} {0.02 * s:.4f} -.07"><joint name="{name}2" axis="{axis}"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.05" size=".0095" rgba=".35 .37 .4 1"/>
      <geom type="sphere" pos="0 0 -.06" size=".012" rgba=".85 .38 .27 1"/></body></body>"""


def hand_model() -> mujoco.MjModel:
    """A five-fingered toy hand over a cylinder on a table."""
    fingers = "".join(finger(n, a) for n, a in zip(FINGERS, np.linspace(0, 5.0, 5), strict=True))
    return mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><light pos="0 0 2" dir="0 0 -1"/>
      <geom type="plane" size="1 1 .1" rgba=".82 .84 .86 1"/>
      <geom type="box" size=".16 .16 .01" pos="0 0 .01" rgba=".72 .62 .5 1"/>
      <body name="palm" pos="0 0 .19"><joint name="lift" type="slide" axis="0 0 1"/>
      <geom type="cylinder" size=".06 .012" pos="0 0 .01" rgba=".2 .22 .26 1"/>{fingers}</body>
      <body name="object" pos="0 0 .07"><freejoint/>
      <geom type="cylinder" size=".03 .045" rgba=".2 .47 .75 1"/></body></worldbody></mujoco>""")


def poses(model: mujoco.MjModel, time: np.ndarray, slip: float) -> np.ndarray:
    """Grasp and lift; `slip` is how far the object lags behind [m]."""
    q = np.tile(model.qpos0, (len(time), 1))
    closure = np.clip(time / 0.8, 0, 1) * (1 - np.clip((time - 2.6) / 0.5, 0, 1))
    lift = 0.09 * np.clip((time - 1.0) / 0.8, 0, 1)
    q[:, 0] = lift
    q[:, 1:11] = np.tile([0.1, 0.42], 5) * closure[:, None]
    object_lift = np.clip((time - 1.0) / 0.8, 0, 1) * (0.09 - slip)
    q[:, 13] = 0.07 + np.where(time < 2.75, object_lift, np.maximum(object_lift - 4.9 * (time - 2.75) ** 2, -0.005))
    turn = slip * 8 * np.clip((time - 1.2) / 1.2, 0, 1)
    q[:, 14], q[:, 15] = np.cos(turn / 2), np.sin(turn / 2)
    return q


def example(model: mujoco.MjModel) -> Example:
    """One episode of 3.2 s at 80 Hz with four traces."""
    rng = np.random.default_rng(3)
    time = np.arange(256) / 80
    shape = 0.9 * np.clip(time / 0.7, 0, 1) * (1 - np.clip((time - 2.5) / 0.35, 0, 1))
    delayed_shape = 0.9 * np.clip((time - 0.06) / 0.78, 0, 1) * (1 - np.clip((time - 2.72) / 0.55, 0, 1))
    force = 2.2 * np.exp(-(((time - 1.8) / 0.75) ** 4))
    traces = [
        Trace(
            "joint_position",
            name,
            "rad",
            scale * delayed_shape + 0.004 * rng.standard_normal(256),
            scale * shape,
            scale * delayed_shape + 0.008 * np.sin(9 * time),
        )
        for name, scale in (("index2", 1.0), ("index1", 0.7))
    ] + [
        Trace(
            "fingertip_force",
            name,
            "N",
            force * 0.8 + 0.03 * rng.standard_normal(256),
            force * k,
            force * 0.81,
        )
        for name, k in (("index_tip z", 1.15), ("thumb_tip z", 1.05), ("ring_tip z", 0.9))
    ]
    return Example(
        "ep-0017",
        time,
        tuple(traces),
        poses(model, time, 0.0),
        poses(model, time, 0.03),
        poses(model, time, 0.002),
    )


def heat(rows: int = 19) -> HeatMap:
    """A map in which index2 stands out at onset and release; no force data in free motion."""
    names = ["object_position", "object_rotation", "joint_position lift x", "joint_position lift y"]
    names += [f"joint_position {f}{k}" for f in FINGERS for k in (1, 2)]
    names += [f"fingertip_force {f}_tip" for f in FINGERS]
    names += [f"joint_position spare{k}" for k in range(max(0, rows - len(names)))]
    names = names[:rows]
    rng = np.random.default_rng(0)
    ratio = np.exp(rng.normal(0.05, 0.12, (len(names), 5)))
    p = rng.uniform(0.1, 1.0, ratio.shape)
    for row, name in enumerate(names):
        if name.startswith("fingertip"):
            ratio[row, 0] = p[row, 0] = np.nan
        if name == "joint_position index2":
            ratio[row], p[row] = [3.1, 4.6, 2.2, 2.8, 17.3], [0.004, 0.002, 0.03, 0.02, 0.001]
        if name == "joint_position index1":
            ratio[row, 4], p[row, 4] = 3.4, 0.008
        if name == "fingertip_force index_tip":
            ratio[row, 1:], p[row, 1:] = [5.2, 1.9, 2.4, 8.8], [0.004, 0.2, 0.04, 0.001]
    return HeatMap(tuple(names), PHASES, ratio, p)


def losses(episodes: int = 24) -> EpisodeLosses:
    """Losses between two and six floors before, about one after."""
    rng = np.random.default_rng(1)
    ids = tuple(f"ep-{k:04d}" for k in range(episodes))
    return EpisodeLosses(
        ids,
        np.exp(rng.normal(1.15, 0.3, episodes)),
        np.exp(rng.normal(0.05, 0.06, episodes)),
        np.full(episodes, 0.9),
        np.exp(rng.normal(0.12, 0.02, episodes)),
    )


def elements(episodes: int = 24) -> Elements:
    """An element for each row of the heat map, with errors in every episode and three courses."""
    rng = np.random.default_rng(2)
    ids = tuple(f"ep-{k:04d}" for k in range(episodes))
    time = np.arange(64) / 20
    elements_list = []
    for label in heat().rows:
        channel, _, element = label.partition(" ")
        size = 6.0 if element == "index2" else 1.5
        null = 0.002 * np.exp(rng.normal(0, 0.1, episodes))
        before = null * size * np.exp(rng.normal(0, 0.3, episodes))
        order = np.argsort(-before)
        real = 0.4 * np.sin(2 * time) + 0.002 * rng.standard_normal(64)
        courses = tuple(
            Course(int(order[k]), time, real, 0.4 * np.sin(2 * time - 0.2), real + 0.004)
            for k in (0, episodes // 2, episodes - 1)
        )
        unit = "N" if channel == "fingertip_force" else "rad"
        elements_list.append(Element(channel, element, unit, before, null * 1.1, null, courses))
    return Elements(ids, tuple(elements_list))


def collinearity() -> Collinearity:
    """Damping and dry friction hard to tell apart, the others not."""
    labels = ("joint_dry_friction index2", "joint_damping index2", "backlash index2", "servo_gain index2")
    matrix = np.array([[1, 0.74, 0.62, -0.2], [0.74, 1, 0.3, 0.1], [0.62, 0.3, 1, 0.05], [-0.2, 0.1, 0.05, 1]])
    return Collinearity(labels, matrix)


def evidence(model: mujoco.MjModel) -> Evidence:
    """All parts."""
    ranges = {("joint_dry_friction", "index2", "frictionloss_Nm"): Range(0.0, 0.3, 0.0)}
    return Evidence(heat(), example(model), losses(), elements(), collinearity(), ranges)


def without_repair(full: Evidence) -> Evidence:
    """The same without a repair, as where nothing is named."""
    example_part, elements_part = full.example, full.elements
    assert example_part is not None
    assert elements_part is not None
    traces = tuple(replace(t, after=None) for t in example_part.traces)
    of = tuple(
        replace(e, after=None, courses=tuple(replace(c, after=None) for c in e.courses)) for e in elements_part.of
    )
    return replace(
        full,
        example=replace(example_part, traces=traces, qpos_after=None),
        elements=replace(elements_part, of=of),
        ranges={},
    )


RANKED_EFFECTS = [
    ("joint_dry_friction", "index2", 214.0, 196.0, 232.0),
    ("joint_damping", "index2", 133.0, 112.0, 151.0),
    ("backlash", "index2", 96.0, 71.0, 118.0),
    ("servo_gain", "index2", 71.0, 52.0, 90.0),
    ("actuation_delay", None, 32.0, 20.0, 45.0),
    ("armature", "index2", 22.0, 8.0, 37.0),
    ("sliding_friction", None, 6.0, -7.0, 19.0),
    ("pose_latency", None, 3.0, -9.0, 12.0),
    ("object_mass", None, 1.0, -6.0, 8.0),
    ("tactile_gain", None, -1.0, -8.0, 6.0),
    ("gravity_tilt", None, -4.0, -12.0, 5.0),
    ("object_com", None, -6.0, -16.0, 4.0),
    ("contact_compliance", None, -7.0, -20.0, 3.0),
    ("tactile_bias", None, -9.0, -24.0, 5.0),
]

YAML = """scene: xhand_tabletop
effects:
- name: joint_dry_friction
  element: index2
  parameters:
    frictionloss_Nm: 0.0412
"""


def report(verdict: str = "explained", **changes) -> Report:
    """A record of the given verdict that obeys the verdict rules."""
    has_effects = verdict in ("explained", "partly_explained")
    effect = {
        "name": "joint_dry_friction",
        "element": "index2",
        "share": 0.81,
        "support": 0.93,
        "parameters": {"frictionloss_Nm": {"value": 0.0412, "low": 0.0373, "high": 0.0458}},
    }
    unknown_part = {
        "acts_on": "object",
        "size": 0.4,
        "unit": "N",
        "depends_on": ["height"],
        "words": "A force of about 0.4 N on the object, growing with height, is left",
    }
    gap = {
        "explained": {"before": 3.12, "after": 1.04, "closed": 0.98, "low": 0.95, "high": 0.99},
        "partly_explained": {"before": 3.12, "after": 2.1, "closed": 0.48, "low": 0.39, "high": 0.55},
        "unknown_effect": {"before": 3.12, "after": 2.8, "closed": 0.15, "low": 0.02, "high": 0.27},
        "ambiguous": {"before": 3.12, "after": 1.08, "closed": 0.96, "low": 0.9, "high": 0.99},
        "no_gap": {"before": 1.02, "after": 1.02},
        "too_little_data": None,
        "out_of_budget": {"before": 3.12, "after": 3.12},
    }[verdict]
    fields = {
        "verdict": verdict,
        "effects": [effect] if has_effects else [],
        "class": ["joint_damping", "joint_dry_friction"] if verdict == "ambiguous" else [],
        "unknown": unknown_part if verdict in ("partly_explained", "unknown_effect", "out_of_budget") else None,
        "ranking": []
        if verdict == "too_little_data"
        else [
            {
                "name": n,
                "element": e,
                "support": max(0.0, g / 230),
                "held_out_gain": g,
                "gain_low": low,
                "gain_high": high,
            }
            for n, e, g, low, high in RANKED_EFFECTS
        ],
        "gap": gap,
        "where": []
        if verdict in ("no_gap", "too_little_data")
        else [
            {"channel": "joint_position", "element": "index2", "phase": "release", "ratio": 17.3, "p": 0.001},
            {
                "channel": "fingertip_force",
                "element": "index_tip",
                "phase": "release",
                "ratio": 8.8,
                "p": 0.001,
            },
            {
                "channel": "joint_position",
                "element": "index2",
                "phase": "onset",
                "regime": "reversal",
                "ratio": 4.6,
                "p": 0.002,
            },
        ],
        "next_motion": {
            "name": "slow_reversals",
            "file": "motion.parquet",
            "separates": ["joint_damping", "joint_dry_friction"],
        }
        if verdict == "ambiguous"
        else None,
        "data": {
            "dataset": "bench-hand@8f31c0a2",
            "floor": "declared",
            "channels": ["object_pose", "joint_position", "fingertip_force", "action"],
            "episodes": {"total": 5, "folds": 0, "held_out": 0}
            if verdict == "too_little_data"
            else {"total": 24, "folds": 4, "held_out": 24},
            "notes": ["3 of 27 episodes left out: shorter than 1 s"],
        },
        "provenance": {"candata": "0.1.0", "mujoco": "4.0.0", "scene": "xhand_tabletop", "seed": "0"},
    }
    return Report.model_validate({**fields, **changes})


@pytest.fixture(scope="session")
def hand() -> mujoco.MjModel:
    return hand_model()


@pytest.fixture(scope="session")
def full_evidence(hand: mujoco.MjModel) -> Evidence:
    return evidence(hand)


@pytest.fixture(scope="session")
def make_report():
    """The function that makes a record of a given verdict."""
    return report


@pytest.fixture(scope="session")
def make_unrepaired():
    """The function that takes the repair out of some evidence."""
    return without_repair


@pytest.fixture(scope="session")
def make_heat():
    """The function that makes a heat map with a given number of rows."""
    return heat


@pytest.fixture
def no_gl(monkeypatch):
    """Asks for pictures without a GL library."""
    monkeypatch.delenv("CANDATA_GL", raising=False)  # kept by a command that ran in this process
    monkeypatch.setenv("MUJOCO_GL", "off")


@pytest.fixture
def small_pictures(monkeypatch):
    """A filmstrip of few pixels, for tests that do not look at it."""
    monkeypatch.setattr(filmstrip, "WIDTH", 48)
    monkeypatch.setattr(filmstrip, "HEIGHT", 40)


BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--enable-logging=stderr")
#: Runs a function in the page once it is loaded, and tells the frame around it what the function saw.
DRIVER = """<script>
addEventListener("load", () => {
  const seen = (FUNCTION)();
  parent.postMessage(JSON.stringify({ ...seen, width: innerWidth, needed: document.documentElement.scrollWidth }), "*");
});
</script></body>"""
#: Holds the page at a width that the browser's own window refuses, and keeps what the driver wrote down.
FRAME = """<!DOCTYPE html><link rel="icon" href="data:,"><output id="seen"></output><script>
addEventListener("message", e => { document.getElementById("seen").textContent = e.data; });
</script><iframe src="page.html" style="width:WIDTHpx;height:900px;border:0"></iframe>"""


@pytest.fixture
def browse(tmp_path):
    """The function that opens a page at a width and returns what a function of the page saw; the console is silent."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no chromium here")

    def run(text: str, function: str, width: int) -> dict:
        folder = tmp_path / "browser"
        folder.mkdir()
        driver = DRIVER.replace("FUNCTION", function)
        (folder / "page.html").write_text(text.replace("</body>", driver), "utf-8")
        (folder / "frame.html").write_text(FRAME.replace("WIDTH", str(width)))
        profile, address = f"--user-data-dir={folder / 'profile'}", (folder / "frame.html").as_uri()
        command = (
            browser,
            *FLAGS,
            "--window-size=1400,1000",
            "--virtual-time-budget=5000",
            profile,
            "--dump-dom",
            address,
        )
        process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert re.findall(r".*:CONSOLE.*", process.stderr) == []
        seen = json.loads(html.unescape(re.search(r'<output id="seen">(.*?)</output>', process.stdout, re.S).group(1)))
        assert seen.pop("width") == width
        assert seen.pop("needed") <= width, "nothing makes the page scroll sideways"
        return seen

    return run
