"""Whether lerobot's own loader opens candata's exports, and whether it gives the same numbers.

    python benchmarks/lerobot_opens.py [--python PYTHON3.12] [--environment FOLDER]

Exports episodes with every kind of channel and with gaps as LeRobot v3.0 and v2.1, opens them with lerobot's own
`LeRobotDataset` in an environment of its own, and compares every column of every frame, the windows that
`delta_timestamps` asks for, their `_is_pad` flags and the statistics. No number may differ.

lerobot pins another torch and is never a dependency: it is installed without its dependencies, and what it imports
only for video (torchvision, av) is stood in for by empty modules. With Python 3.12 it is the newest that was tried,
else 0.4.4, which borrows the running environment's torch. v2.1 sets are no longer opened by these; 0.3.3 does it.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import textwrap
from pathlib import Path

import numpy as np

from candata.formats import Writing
from candata.formats._packing import survey
from candata.formats.lerobot import FORMAT
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ, ROWS, EPISODES, JOINTS, FINGERTIPS = 50.0, 60, 6, 4, 3
STEPS = (-2, -1, 0, 1, 2)
TORCH = "torch==2.13.0"
#: lerobot and the `datasets` it was made for.
NEWEST, FOR_311, FOR_V21 = ("0.6.1", "4.8.5"), ("0.4.4", "4.4.1"), ("0.3.3", "3.6.0")
#: pip warns that lerobot's pins are not met, which is meant.
QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
LIGHT = "pandas<3 pyarrow huggingface-hub<1.0 draccus==0.10.0 einops packaging jsonlines deepdiff termcolor requests"
LIGHT += " gymnasium safetensors Pillow tqdm fsspec dill multiprocess xxhash aiohttp httpx imageio"

PROBE = """
    import importlib.abc, importlib.machinery, importlib.metadata, json, sys, types

    class Zero(type):  # what is asked of a class is 0, which serves as a log level
        def __getattr__(cls, name):
            if name.startswith("__"):
                raise AttributeError(name)
            return 0

    class Stand(types.ModuleType):  # an empty module: any name in it is a class that does nothing
        __path__ = []
        def __getattr__(self, name):
            if name.startswith("__"):
                raise AttributeError(name)
            return Zero(name, (), {"__init__": lambda self, *a, **k: None})

    class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
        def find_spec(self, name, path=None, target=None):
            if name.split(".")[0] in ("torchvision", "av", "cv2", "accelerate", "diffusers", "rerun", "serial"):
                return importlib.machinery.ModuleSpec(name, self, is_package=True)
        def create_module(self, spec):
            return Stand(spec.name)
        def exec_module(self, module):
            pass

    sys.meta_path.append(Finder())
    import numpy as np, torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root, target, steps = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    plain = LeRobotDataset("local/set", root=root)
    keys = [k for k in plain.meta.features if k.startswith("observation") or k == "action"]
    deltas = {k: [s / plain.fps for s in steps] for k in keys}
    windows = LeRobotDataset("local/set", root=root, delta_timestamps=deltas)
    frames = [plain[i] for i in range(len(plain))]
    views = [windows[i] for i in range(len(windows))]
    found = {f"frame/{k}": np.array([np.asarray(f[k]) for f in frames]) for k in frames[0]}
    found |= {f"window/{k}": np.array([np.asarray(v[k]) for v in views]) for k in keys}
    found |= {f"window/{k}_is_pad": np.array([np.asarray(v[k + "_is_pad"]) for v in views]) for k in keys}
    found |= {f"stats/{k}/{n}": np.asarray(v) for k, one in plain.meta.stats.items() for n, v in one.items()}
    np.savez(target, **found)
    print(importlib.metadata.version("lerobot"), importlib.metadata.version("datasets"), torch.__version__)
"""


def made() -> list[Episode]:
    """Return episodes with gaps, an optional channel and odd names."""
    rng = np.random.default_rng(0)
    made = []
    for number in range(EPISODES):
        rows = ROWS + number
        quaternion = rng.normal(size=(rows, 4))
        arrays = {
            "time_ns": np.arange(rows) * round(1e9 / RATE_HZ),
            "object_pose": np.c_[rng.normal(size=(rows, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]],
            "object_velocity": rng.normal(size=(rows, 6)),
            "joint_position": rng.normal(size=(rows, JOINTS)),
            "joint_velocity": rng.normal(size=(rows, JOINTS)),
            "action": rng.normal(size=(rows, JOINTS)),
            "fingertip_force": rng.normal(size=(rows, FINGERTIPS, 3)),
            "fingertip_contact": rng.random((rows, FINGERTIPS)) < 0.5,
            "contact": rng.random(rows) < 0.5,
        }
        if number % 2:
            arrays["fingertip_force_valid"] = rng.random(rows) < 0.8
            arrays["fingertip_force"][~arrays["fingertip_force_valid"]] = np.nan
        if number == 3:
            del arrays["object_velocity"]
        names = {"joint_names": ("pouce", "zeigefinger", "人差し指", "d"), "actuator_names": ("a", "b", "c", "d")}
        meta = EpisodeMeta(id=f"e{number}", source="sim", rate_hz=RATE_HZ, task=f"task {number % 2}", **names)
        made.append(Episode(meta, arrays))
    return made


def expected(episodes: list[Episode]) -> dict[str, np.ndarray]:
    """Return what the loader must give, from candata's own arrays alone."""
    columns: dict[str, list[np.ndarray]] = {}
    for number, episode in enumerate(episodes):
        rows = len(episode)
        velocity = "object_velocity" in episode
        own = {
            "observation.state": np.concatenate(
                [episode[c].reshape(rows, -1) for c in ("joint_position", "joint_velocity", "fingertip_force")], axis=1
            ),
            "time_ns": episode["time_ns"],
            "observation.object_velocity": episode["object_velocity"] if velocity else np.zeros((rows, 6), np.float32),
            "valid.object_velocity": np.full(rows, velocity),
            "valid.fingertip_force": episode.valid("fingertip_force"),
            "action": episode["action"],
            "timestamp": (np.arange(rows) / RATE_HZ).astype(np.float32),
            "frame_index": np.arange(rows),
            "episode_index": np.full(rows, number),
            "task_index": np.full(rows, number % 2),
            "task": np.full(rows, f"task {number % 2}"),
        }
        for channel in ("object_pose", "joint_position", "joint_velocity", "fingertip_force", "fingertip_contact"):
            own[f"observation.{channel}"] = episode[channel].reshape(rows, -1)
        own["observation.contact"] = episode["contact"]
        for key, values in own.items():
            columns.setdefault(key, []).append(values)
    frames = {key: np.concatenate(parts) for key, parts in columns.items()}
    frames["index"] = np.arange(len(frames["time_ns"]))
    wanted = {f"frame/{key}": values for key, values in frames.items()}
    return wanted | _windows(frames, np.cumsum([0, *map(len, episodes)]))


def _windows(frames: dict[str, np.ndarray], ends: np.ndarray) -> dict[str, np.ndarray]:
    """Return the windows around each frame, clamped to the episode, and where they were clamped."""
    index, steps = np.arange(ends[-1])[:, None], np.array(STEPS)
    first, last = (np.repeat(bound, np.diff(ends))[:, None] for bound in (ends[:-1], ends[1:] - 1))
    rows = np.clip(index + steps, first, last)
    keys = [key for key in frames if key.startswith("observation") or key == "action"]
    made = {f"window/{key}": frames[key][rows] for key in keys}
    return made | {f"window/{key}_is_pad": (index + steps < first) | (index + steps > last) for key in keys}


def compare(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> list[str]:
    """Return what differs: keys, shapes, kinds, numbers; equal means the same bits (NaN equals NaN)."""
    loaded = {key for key in found if not key.startswith("stats/")}
    problems = [f"only one side has {key}" for key in sorted(loaded ^ set(wanted))]
    for key in sorted(loaded & set(wanted)):
        a, b = found[key], wanted[key]
        if a.shape != b.shape or a.dtype.kind != b.dtype.kind:
            problems.append(f"{key}: {a.dtype}{a.shape} instead of {b.dtype}{b.shape}")
        elif not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            problems.append(f"{key}: {int((a != b).sum())} numbers differ")
    return problems + _stats(found, wanted)


def _stats(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> list[str]:
    """Return which statistics are not those of the frames; 1e-6 covers the order of summation."""
    problems = []
    for key in (key.removeprefix("frame/") for key in wanted if key.startswith("frame/") and key != "frame/task"):
        values = wanted[f"frame/{key}"].astype(np.float64).reshape(len(wanted["frame/index"]), -1)
        # v2.1 weights episodes by one count for all columns, which cannot hold for those that have gaps of their own.
        gaps = ~np.isfinite(values).all(axis=0)
        weighed = np.where(gaps & (gaps.any() and not gaps.all()), f"stats/{key}/q50" in found, True)
        for name, reduce in (("mean", np.nanmean), ("std", np.nanstd), ("min", np.nanmin), ("max", np.nanmax)):
            own = found.get(f"stats/{key}/{name}")
            scale = np.abs(values[np.isfinite(values)]).max()
            near = own is not None and np.isclose(own, reduce(values, axis=0), rtol=1e-6, atol=1e-6 * scale)
            if not np.all(near | ~weighed):
                problems.append(f"stats of {key}: {name} is not that of the frames")
    return problems


def environment(folder: Path, python: str, lerobot: tuple[str, str]) -> Path:
    """Return the interpreter of an environment with lerobot, made unless it stands."""
    runs = folder / "bin" / "python"
    if (folder / "ready").is_file():
        return runs
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", folder], check=True)
    version, datasets = lerobot
    install = [runs, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if _version(python) == sys.version_info[:2]:
        own = subprocess.run(
            [runs, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
            check=True,
            capture_output=True,
            text=True,
        )
        Path(own.stdout.strip(), "running.pth").write_text(sysconfig.get_path("purelib") + "\n")
    subprocess.run([*install, "--no-deps", f"lerobot=={version}", f"datasets=={datasets}"], check=True, **QUIET)
    subprocess.run([*install, *LIGHT.split()], check=True, **QUIET)
    borrowed = subprocess.run([runs, "-c", "import torch"], capture_output=True).returncode == 0
    if not borrowed:
        subprocess.run([*install, TORCH], check=True, **QUIET)
    (folder / "ready").touch()
    return runs


def _version(python: str) -> tuple[int, int] | None:
    """Return the version of an interpreter, or None where it does not run (a shim may stand in for it)."""
    code = "import sys; print(*sys.version_info[:2])"
    try:
        found = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        return None
    return int(found[0]), int(found[1])


def check(variant: str | None, python: str, lerobot: tuple[str, str], environments: Path, scratch: Path) -> int:
    """Print what lerobot makes of an export, and return the number of differences."""
    label = "v2.1" if variant else "v3.0"
    episodes = made()
    root = scratch / label
    root.mkdir()
    FORMAT.write(episodes, root, Writing("benchmark", "0" * 64, variant=variant))
    try:
        runs = environment(environments / f"lerobot-{lerobot[0]}", python, lerobot)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"{label}: unknown, as lerobot {lerobot[0]} could not be installed: {error}")
        return 0
    probe, target = scratch / "probe.py", scratch / f"{label}.npz"
    probe.write_text(textwrap.dedent(PROBE))
    offline = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(scratch / "hub"), "PATH": "", "HOME": str(scratch)}
    ran = subprocess.run(
        [runs, "-W", "ignore", probe, root, target, str(list(STEPS))], env=offline, capture_output=True, text=True
    )
    if ran.returncode:
        print(f"{label}: lerobot {lerobot[0]} does not open it: {ran.stderr.strip().splitlines()[-1]}")
        return 1
    with np.load(target, allow_pickle=False) as loaded:
        found = dict(loaded)
    problems = compare(found, expected(episodes))
    versions = "lerobot {}, datasets {}, torch {}".format(*ran.stdout.split()[-3:])
    frames = survey(episodes).rows
    print(f"{label}: {len(problems)} differences, target 0 ({frames} frames, {len(found)} arrays; {versions})")
    for line in problems:
        print(f"  {line}")
    return len(problems)


def main() -> None:
    """Check both layouts; exit 1 where a number differs."""
    parser = argparse.ArgumentParser(description="Open candata's LeRobot exports with lerobot's own loader.")
    parser.add_argument("--python", default="python3.12", help="interpreter for the newest lerobot")
    parser.add_argument("--environment", type=Path, help="keep the environments here (large) [made and deleted]")
    chosen = parser.parse_args()
    python, newest = (chosen.python, NEWEST) if _version(chosen.python) == (3, 12) else (sys.executable, FOR_311)
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        environments = (chosen.environment or scratch / "environments").resolve()
        environments.mkdir(parents=True, exist_ok=True)
        missed = check(None, python, newest, environments, scratch)
        missed += check("v21", sys.executable, FOR_V21, environments, scratch)
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
