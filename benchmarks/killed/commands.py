"""The commands that `kills.py` kills, the folder that they begin in, and what they make there as plain values."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from candata.schema.bench import Kind

Words = tuple[object, ...]
#: Files that commands read.
SOURCES = (
    "bench/sealed.json",
    "torn.mcap",
    "whole.mcap",
    "table.csv",
    "map.yaml",
    "block.obj",
    "model.xml",
    "effects.yaml",
    "net.yaml",
)
#: Formats that are exported.
FORMATS = ("lerobot", "robomimic", "diffusion_policy", "mcap")
#: A model that is trained in a second.
NET = (
    *("--model", "mlp", "--config", "net.yaml", "--batch", 4, "--steps", 12, "--threads", 1),
    *("--history", 2, "--horizon", 4),
)
#: Two cases of tosses; their labels are sealed before.
BENCH_KINDS: dict[Kind, int] = {"one": 1, "null": 1}
BENCH = (
    *("--scene", "cube_toss", "--episodes", 8, "--duration-s", 0.5, "--jobs", 1, "--no-follow"),
    *("--kinds", "one,null", "--counts", "one=1,null=1", "--only", "sliding_friction"),
)
MODEL = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="box" pos="0 0 .1"><freejoint/><geom size=".05" mass=".1"/></body>
    <body name="arm" pos=".3 0 .2"><joint name="hinge" axis="0 1 0"/><geom name="tip" size=".03"/></body>
  </worldbody>
  <actuator><position name="drive" joint="hinge" kp="1"/></actuator>
</mujoco>
"""
#: A corner of a block: a mesh of four triangles.
BLOCK = "v 0 0 0\nv .06 0 0\nv 0 .04 0\nv 0 0 .03\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
EFFECTS = """scene: gripper_tabletop
effects:
  - {name: object_mass, parameters: {mass_scale: 1.5}}
"""


class Command(NamedTuple):
    """A command line, seen from its folder, what it makes there, and how often it is killed beside the others."""

    name: str
    words: Words
    made: Callable[[], object]
    weight: float = 1.0


def commands() -> list[Command]:
    """Return what is killed."""
    sim, toss = ("--scene", "cube_toss", "--duration-s", 0.3, "--jobs", 1), ("--episodes", 20, "--seed", 7)
    log = ("import", "log", "whole.mcap", "--uncalibrated", "--rate", 80)
    grip = ("grip", "--scene", "gripper_tabletop", "--only", "joint_damping", "--jobs", 1)
    new, more = ("--out", "new"), ("--out", "base", "--append")
    return [
        Command("generate-sim", ("generate-sim", *sim, *toss, *new), lambda: dataset("new")),
        Command("generate-sim more", ("generate-sim", *sim, *toss, "--out", "tosses"), lambda: dataset("tosses")),
        Command("import", ("import", "table", "map.yaml", *new), lambda: dataset("new")),
        Command("import --append", ("import", "table", "map.yaml", *more), lambda: dataset("base")),
        Command("import lerobot", ("import", "lerobot", "exported", *new), lambda: dataset("new")),
        Command("import log", (*log, *new), lambda: dataset("new")),
        *(Command(f"export {kind}", ("export", kind, "tosses", *new), lambda: files("new")) for kind in FORMATS),
        Command("filter", ("registry", "filter", "base", "id <> 'e3'", *new), lambda: dataset("new")),
        Command("merge", ("registry", "merge", "base", "other", *new), lambda: dataset("new")),
        Command("merge --append", ("registry", "merge", "other", *more), lambda: dataset("base")),
        Command("relabel", ("registry", "relabel", "base", "--set", "task=x", *new), lambda: dataset("new")),
        Command("tag", ("registry", "tag", "base", "first", "--version", 1), lambda: files("base/tags")),
        Command(
            "tag --move", ("registry", "tag", "base", "clean", "--version", 1, "--move"), lambda: files("base/tags")
        ),
        Command("tag --delete", ("registry", "tag", "base", "spare", "--delete"), lambda: files("base/tags")),
        Command("add", ("registry", "add", "more", "other"), registry),
        Command("remove", ("registry", "remove", "spare"), registry),
        Command("remotes add", ("registry", "remotes", "add", "disk", "share"), registry),
        Command("remotes remove", ("registry", "remotes", "remove", "spare"), registry),
        Command("split", ("registry", "split", "base", "mine"), lambda: files("base/splits")),
        Command("push", ("registry", "push", "base", "lab"), lambda: remote("share")),
        Command("pull", ("registry", "pull", "store", "base", *new), lambda: dataset("new")),
        Command("pull again", ("registry", "pull", "store", "base", "--out", "old"), lambda: dataset("old")),
        Command("compact", ("compact", "base"), lambda: [dataset("base"), parts("base")]),
        Command("gc", ("gc", "base", "--grace", "0s", "--keep", 1), lambda: [dataset("base"), names("base")]),
        Command("train", ("train", "--data", "grip", *NET, *new), lambda: weights("new")),
        Command("evaluate", ("evaluate", "run", "grip", "--threads", 1, *new), lambda: files("new"), 0.5),
        Command("validate", ("validate", "grip", "--html", "page.html"), lambda: files(".", "page.html"), 0.5),
        Command("inspect", ("inspect", "grip", "--html", "page.html"), lambda: files(".", "page.html"), 0.5),
        Command("scene init", ("scene", "init", "model.xml"), lambda: files(".", "scene.yaml")),
        Command("scene servo", ("scene", "servo", "--dataset", "driven", *new), lambda: files("new")),
        Command(
            "scene object add",
            ("scene", "object", "add", "block.obj", "--mass", 0.1, *new),
            lambda: files("new"),
        ),
        Command("scene export", ("scene", "export", "--effects", "effects.yaml", *new), lambda: files("new")),
        Command("recover", ("recover", "torn.mcap", "--out", "new.mcap"), lambda: messages("new.mcap")),
        Command("diagnose", ("diagnose", *grip, *new, "--cache-dir", "kept"), lambda: report("new"), 0.25),
        Command("gap bench", ("gap", "bench", *BENCH, "--out", "bench"), lambda: scored("bench"), 0.25),
        Command("gap signatures", ("gap", "signatures", *grip, "--cache-dir", "kept"), lambda: files("kept"), 0.5),
    ]


def dataset(name: str) -> object:
    """Return number, digest and contents of the newest version of a dataset; None where there is none."""
    from candata.datasets import open_dataset
    from candata.errors import CandataError

    try:
        opened = open_dataset(name)
        return {"digest": opened.digest, "contents": dict(opened.contents(opened.ids))}
    except CandataError as error:
        return None if not list(Path(name).glob("versions/*.json")) else f"DAMAGED {error}"


def parts(name: str) -> list[str]:
    """Return the parts of the newest version."""
    from candata.datasets import open_dataset

    return sorted(entry.id for entry in open_dataset(name).file.parts)


def names(name: str) -> list[str]:
    """Return the parts and versions that stand."""
    return sorted(path.name for folder in ("parts", "versions") for path in (Path(name) / folder).iterdir())


def files(name: str, pattern: str = "*") -> dict[str, str]:
    """Return the hash of each file of a name under a folder, hidden drafts left out."""
    found = [path for path in Path(name).rglob(pattern) if path.is_file() and not path.name.startswith(".")]
    return {str(path.relative_to(name)): _hash(path) for path in found}


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def registry() -> dict[str, dict[str, str]]:
    """Return the names in the registry and what they stand for, as seen from its folder."""
    found = json.loads(Path("registry.json").read_text())
    datasets = {name: os.path.relpath(path) for name, path in found["datasets"].items()}
    return {"datasets": datasets, "remotes": {name: os.path.relpath(e["url"]) for name, e in found["remotes"].items()}}


def remote(name: str) -> object:
    """Return the versions of a remote and whether all that they name is there, hash by hash."""
    versions = sorted(Path(name, "base", "versions").glob("*.json"))
    objects = files(f"{name}/base/objects")
    broken = [key for key, digest in objects.items() if key != digest]
    named = [entry["sha256"] for path in versions for entry in json.loads(path.read_text())["version"]["parts"]]
    lacking = [sha for sha in named if sha not in objects]
    return {"versions": [path.name for path in versions], "broken": broken, "lacking": lacking}


def weights(name: str) -> object:
    """Return the hash of the tensors of the last and the best checkpoint."""
    from safetensors import safe_open

    found = {}
    for path in sorted(Path(name).glob("*.safetensors")):
        with safe_open(path, "np") as file:
            arrays = {key: file.get_tensor(key).tobytes() for key in sorted(file.keys())}
        found[path.name] = hashlib.sha256(b"".join(arrays.values())).hexdigest()
    return found


def messages(name: str) -> object:
    """Return what a log holds."""
    from candata.record.logs import read_log

    if not Path(name).exists():
        return None
    log = read_log(name)
    return [log.torn, len(log.joint_position), hashlib.sha256(log.joint_position.tobytes()).hexdigest()]


def report(name: str) -> object:
    """Return a diagnosis' report."""
    path = Path(name, "report.json")
    return json.loads(path.read_text()) if path.is_file() else None


def scored(name: str) -> object:
    """Return the results of a bench without what depends on the clock; None before it has a score."""
    if not Path(name, "bench.json").is_file():
        return None
    score = json.loads(Path(name, "bench.json").read_text())
    lines = [json.loads(line) for line in Path(name, "results.jsonl").read_text().splitlines()]
    results = {line["case"]: [line["sealed"], line["cold"], line["report"], line["error"]] for line in lines}
    return [len(lines), results, score["misses"], [row for row in score["rows"] if row["unit"] != "s"]]


def standing() -> dict[str, dict[str, str]]:
    """Return what was there before: contents by episode id, of each dataset; hashes of the other files."""
    found = {name: dataset(name) for name in ("base", "other", "tosses", "grip", "driven", "old")}
    kept = {name: value["contents"] if isinstance(value, dict) else {} for name, value in found.items()}
    names = {
        f"{kind} {name}": to for kind, pairs in registry().items() for name, to in pairs.items() if name != "spare"
    }
    whole = {key: digest for folder in ("store", "exported", "run") for key, digest in files(folder).items()}
    return kept | {"registry": names, "files": whole | {name: _hash(Path(name)) for name in SOURCES}}


def lost(before: dict[str, dict[str, str]], now: dict[str, dict[str, str]]) -> list[str]:
    """Return what is missing or another of what stood before."""
    return [f"{kind} {key}" for kind, old in before.items() for key in old if now[kind].get(key) != old[key]]


def run(words: Words) -> int:
    """Run a command in this process; return its exit code."""
    from candata_cli.main import main

    try:
        main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)


def prepare() -> list[int]:
    """Make datasets, a remote, a table and a torn log in the folder where this process stands."""
    import numpy as np

    from candata.datasets import append, create_dataset, open_dataset, put_cloud
    from candata.gap.blind.labels import seal_labels
    from candata.scenes import load_scene
    from candata.schema.episode import Episode, EpisodeMeta
    from candata.schema.manifest import Lineage

    def episode(name: str, cloud: str | None = None) -> Episode:
        rng = np.random.default_rng(list(name.encode()))
        arrays = {"time_ns": np.arange(40) * 12_500_000, "joint_position": rng.normal(size=(40, 4))}
        return Episode(EpisodeMeta(id=name, source="sim", rate_hz=80, point_cloud=cloud), arrays)

    for name in ("share", "store", "kept"):
        Path(name).mkdir()
    base, other = create_dataset("base"), create_dataset("other")
    cloud = put_cloud(base, np.eye(3))
    for some in (["e0", "e1", "e2"], ["e3"], ["e4", "e5"]):
        append(base, [episode(one, cloud) for one in some], Lineage(operation="test"), part_size=2)
    append(other, [episode("e0", put_cloud(other, np.eye(3))), episode("x")], Lineage(operation="test"))
    rows = [f"{e},{i * 0.0125},{i * 0.01 * (e + 1)}" for e in range(3) for i in range(40)]
    Path("table.csv").write_text("episode,t,q\n" + "\n".join(rows) + "\n")
    channels = "{joint_position: [q], action: [q]}"
    Path("map.yaml").write_text(
        f"file: table.csv\nsource: sim\nepisode: episode\ntime_s: t\nrate_hz: 80\nchannels: {channels}\n"
    )
    Path("net.yaml").write_text("{width: 16, layers: 1}")
    Path("block.obj").write_text(BLOCK)
    Path("model.xml").write_text(MODEL)
    Path("effects.yaml").write_text(EFFECTS)
    scene = load_scene("cube_toss")
    Path("bench").mkdir()
    seal_labels(
        Path("bench"), scene, BENCH_KINDS, seed=1, episodes=8, duration_s=0.5, only=("sliding_friction",), salt="0" * 64
    )
    _write_log(Path("whole.mcap"))
    log = Path("whole.mcap").read_bytes()
    Path("torn.mcap").write_bytes(log[: len(log) // 2])
    sim = ("generate-sim", "--jobs", 1, "--scene")
    lines: list[Words] = [
        ("registry", "tag", "base", "clean"),
        ("registry", "split", "base"),
        ("registry", "push", "base", "store"),
        ("registry", "pull", "store", "base@1", "--out", "old"),
        (*sim, "cube_toss", "--duration-s", 0.3, "--episodes", 4, "--seed", 7, "--out", "tosses"),
        (*sim, "gripper_tabletop", "--duration-s", 1.2, "--episodes", 8, "--seed", 5, "--out", "grip"),
        ("registry", "tag", "base", "spare"),
        ("import", "table", "map.yaml", "--out", "driven"),
        ("export", "lerobot", "tosses", "--out", "exported"),
        ("train", "--data", "grip", *NET, "--out", "run"),
    ]
    codes = [run(words) for words in lines]
    return codes if not any(codes) and len(open_dataset("base")) == 6 else [][1]


def _write_log(path: Path) -> None:
    """Write a log of five seconds."""
    import numpy as np

    from candata.record.devices._contract import States
    from candata.record.logs import LogMeta, LogWriter

    meta = LogMeta(
        device="d",
        joint_names=("a",),
        fingertip_names=("t",),
        taxels=0,
        newton_per_count=0.1,
        count_low=(-128, -128, 0),
        count_high=(127, 127, 255),
        rate_hz=80.0,
    )
    writer, one = LogWriter(path, meta), np.zeros((1, 1))
    for i in range(400):
        force, taxels = np.zeros((1, 1, 3), np.int16), np.zeros((1, 1, 0, 3), np.int16)
        writer.states([i * 12_500_000], States(one + i, one, one, force, taxels))
        if i % 50 == 0:
            writer.flush()
    writer.close()
