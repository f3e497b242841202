"""The commands that `kills.py` kills, the folder that they begin in, and what they make there as plain values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

Words = tuple[object, ...]


class Command(NamedTuple):
    """A command line, seen from its folder, what it makes there, and how often it is killed beside the others."""

    name: str
    words: Words
    made: Callable[[], object]
    weight: float = 1.0


def commands() -> list[Command]:
    """Return what is killed."""
    sim, toss = ("--scene", "cube_toss", "--duration-s", 0.3, "--jobs", 1), ("--episodes", 20, "--seed", 7)
    net = ("--model", "mlp", "--config", "net.yaml", "--batch", 4, "--steps", 12, "--threads", 1)
    net += ("--history", 2, "--horizon", 4)
    grip = ("grip", "--scene", "gripper_tabletop", "--only", "joint_damping", "--jobs", 1)
    new, more = ("--out", "new"), ("--out", "base", "--append")
    return [
        Command("generate-sim", ("generate-sim", *sim, *toss, *new), lambda: dataset("new")),
        Command("generate-sim more", ("generate-sim", *sim, *toss, "--out", "tosses"), lambda: dataset("tosses")),
        Command("import", ("import", "table", "map.yaml", *new), lambda: dataset("new")),
        Command("import --append", ("import", "table", "map.yaml", *more), lambda: dataset("base")),
        Command("export", ("export", "lerobot", "tosses", *new), lambda: files("new")),
        Command("filter", ("registry", "filter", "base", "id <> 'e3'", *new), lambda: dataset("new")),
        Command("merge", ("registry", "merge", "base", "other", *new), lambda: dataset("new")),
        Command("merge --append", ("registry", "merge", "other", *more), lambda: dataset("base")),
        Command("relabel", ("registry", "relabel", "base", "--set", "task=x", *new), lambda: dataset("new")),
        Command("tag", ("registry", "tag", "base", "first", "--version", 1), lambda: files("base/tags")),
        Command(
            "tag --move", ("registry", "tag", "base", "clean", "--version", 1, "--move"), lambda: files("base/tags")
        ),
        Command("split", ("registry", "split", "base", "mine"), lambda: files("base/splits")),
        Command("push", ("registry", "push", "base", "lab"), lambda: remote("share")),
        Command("pull", ("registry", "pull", "store", "base", *new), lambda: dataset("new")),
        Command("pull again", ("registry", "pull", "store", "base", "--out", "old"), lambda: dataset("old")),
        Command("compact", ("compact", "base"), lambda: [dataset("base"), parts("base")]),
        Command("gc", ("gc", "base", "--grace", "0s", "--keep", 1), lambda: [dataset("base"), names("base")]),
        Command("train", ("train", "--data", "grip", *net, *new), lambda: weights("new")),
        Command("recover", ("recover", "torn.mcap", "--out", "new.mcap"), lambda: messages("new.mcap")),
        Command("diagnose", ("diagnose", *grip, *new, "--cache-dir", "kept"), lambda: report("new"), 0.25),
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


def files(name: str) -> dict[str, str]:
    """Return the hash of each file under a folder, hidden drafts left out."""
    found = [path for path in Path(name).rglob("*") if path.is_file() and not path.name.startswith(".")]
    return {str(path.relative_to(name)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


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


def standing() -> dict[str, dict[str, str]]:
    """Return what was there before: contents by episode id, of each dataset; hashes of the other files."""
    found = {name: dataset(name) for name in ("base", "other", "tosses", "grip", "old")}
    kept = {name: value["contents"] if isinstance(value, dict) else {} for name, value in found.items()}
    return kept | {"files": {**files("store"), **{n: files(".")[n] for n in ("torn.mcap", "table.csv", "map.yaml")}}}


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
    rows = [f"{e},{i * 0.0125},{i * 0.01 * (e + 1)},{i}" for e in range(3) for i in range(40)]
    Path("table.csv").write_text("episode,t,q,u\n" + "\n".join(rows) + "\n")
    channels = "{joint_position: [q], action: [u]}"
    Path("map.yaml").write_text(
        f"file: table.csv\nsource: sim\nepisode: episode\ntime_s: t\nrate_hz: 80\nchannels: {channels}\n"
    )
    Path("net.yaml").write_text("{width: 16, layers: 1}")
    _write_torn(Path("torn.mcap"))
    sim = ("generate-sim", "--jobs", 1, "--scene")
    lines: list[Words] = [
        ("registry", "tag", "base", "clean"), ("registry", "split", "base"), ("registry", "push", "base", "store"),
        ("registry", "pull", "store", "base@1", "--out", "old"),
        (*sim, "cube_toss", "--duration-s", 0.3, "--episodes", 4, "--seed", 7, "--out", "tosses"),
        (*sim, "gripper_tabletop", "--duration-s", 1.2, "--episodes", 8, "--seed", 5, "--out", "grip"),
    ]  # fmt: skip
    codes = [run(words) for words in lines]
    return codes if not any(codes) and len(open_dataset("base")) == 6 else [][1]


def _write_torn(path: Path) -> None:
    """Write a log and cut it in the middle."""
    import numpy as np

    from candata.record.devices._contract import States
    from candata.record.logs import LogMeta, LogWriter

    meta = LogMeta(
        device="d", joint_names=("a",), fingertip_names=("t",), taxels=0, newton_per_count=0.1,
        count_low=(-128, -128, 0), count_high=(127, 127, 255), rate_hz=80.0,
    )  # fmt: skip
    writer, one = LogWriter(path, meta), np.zeros((1, 1))
    for i in range(400):
        force, taxels = np.zeros((1, 1, 3), np.int16), np.zeros((1, 1, 0, 3), np.int16)
        writer.states([i * 12_500_000], States(one + i, one, one, force, taxels))
        if i % 50 == 0:
            writer.flush()
    writer.close()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
