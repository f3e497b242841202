"""Probes of a folder or share: whether it keeps the promises that a dataset stands on."""

from __future__ import annotations

import errno
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from candata.datasets import durable
from candata.datasets.kill_test import kill_test
from candata.errors import CandataError, UsageError, Where

#: Free space below which a folder counts as full: some minutes of recording with taxels (2 MB an episode).
LEAST_FREE_BYTES = 500_000_000

#: Largest difference between the clocks of host and file system; ages and grace periods are counted in days.
LARGEST_SKEW_S = 60.0

_RACERS = 8
_LOCAL = "keep datasets on a local disk, and share them with candata push"


@dataclass(frozen=True)
class Probe:
    """One promise of a file system: whether it holds (None: not tried), what was found, what to do if not."""

    name: str
    ok: bool | None
    found: str
    fix: str = ""


def probe_folder(
    path: str | Path, *, kills: int = 12, progress: Callable[[str], None] = lambda name: None
) -> tuple[Probe, ...]:
    """Return what a folder promises: space, writing, renames, exclusive creation, fsync, clock, and the kill test.

    All is tried in a scratch folder inside it, which is removed at the end.

    Parameters
    ----------
    path : str or Path
        Existing folder, such as a dataset's or the one that shall hold datasets.
    kills : int
        Processes to kill; 0 leaves the kill test out.
    progress : callable
        Called with the name of each probe before it runs.

    Raises
    ------
    UsageError
        When there is no such folder.
    """
    root = Path(path)
    if not root.is_dir():
        raise UsageError("not a folder", expected="an existing folder", where=Where(path=str(root)))
    probes: list[Probe] = []
    progress("space")
    probes.append(_space(root))
    try:
        with _scratch(root) as folder:
            probes.append(Probe("write", True, "folders and files can be made and removed"))
            for name, probe in _PROBES.items():
                progress(name)
                probes.append(_run_probe(name, probe, folder))
            is_sound = all(result.ok for result in probes if result.name in _REQUIRED_PROBES)
            progress("kill test")
            probes.append(_kill(folder, kills, is_sound))
    except OSError as error:
        probes.append(
            Probe("write", False, durable.reason(error), "ask for the right to write, or take another folder")
        )
    return tuple(probes)


@contextmanager
def _scratch(root: Path) -> Iterator[Path]:
    """Give a fresh folder in `root`, removed at the end."""
    folder = root / f".candata-doctor-{uuid.uuid4().hex[:12]}"
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run_probe(name: str, probe: Callable[[Path], tuple[bool, str, str]], folder: Path) -> Probe:
    """Return what a probe finds in a folder of its own; what the system raises is a finding too."""
    home = folder / name.replace(" ", "-")
    home.mkdir()
    try:
        ok, finding, fix = probe(home)
    except OSError as error:
        return Probe(name, False, durable.reason(error), "keep datasets on a local disk, or ask who runs the share")
    return Probe(name, ok, finding, "" if ok else fix)


def _space(root: Path) -> Probe:
    """Return the free space."""
    usage = shutil.disk_usage(root)
    free_text = f"{usage.free / 1e9:.1f} GB free of {usage.total / 1e9:.1f} GB"
    is_enough = usage.free >= LEAST_FREE_BYTES
    return Probe("space", is_enough, free_text, "" if is_enough else f"free at least {LEAST_FREE_BYTES / 1e9:g} GB")


def _rename_file(home: Path) -> tuple[bool, str, str]:
    """Replace a file again and again while another thread reads it: it must always be whole."""
    target, texts, contents, stop = home / "target", {b"a" * 65536, b"b" * 65536}, set(), threading.Event()
    target.write_bytes(min(texts))

    def read() -> None:
        while not stop.is_set():
            try:
                contents.add(target.read_bytes())
            except FileNotFoundError:
                contents.add(b"")

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for text in sorted(texts) * 20:
            (home / "draft").write_bytes(text)
            (home / "draft").replace(target)
    finally:
        stop.set()
        reader.join()
    ok = contents <= texts
    return ok, "a replaced file is never missing or half" if ok else "a file was missing or half", "use a local disk"


def _rename_folder(home: Path) -> tuple[bool, str, str]:
    """Rename a folder with a file; a folder that holds something must not be replaced."""
    for name in ("one", "two"):
        (home / name).mkdir()
        (home / name / "file").write_text(name)
    os.rename(home / "one", home / "three")
    is_moved = not (home / "one").exists() and (home / "three" / "file").read_text() == "one"
    try:
        os.rename(home / "two", home / "three")
        is_refused = False
    except OSError:
        is_refused = (home / "three" / "file").read_text() == "one"
    summary = "a folder is renamed whole; a taken name is refused"
    return (
        is_moved and is_refused,
        summary if is_moved and is_refused else "a folder was replaced or came in pieces",
        _LOCAL,
    )


def _exclusive(home: Path) -> tuple[bool, str, str]:
    """Link several drafts to one name at once: one must win."""
    winners, start = [], threading.Barrier(_RACERS)
    problems: list[OSError] = []

    def race(number: int) -> None:
        (home / f"draft{number}").write_text(str(number))
        start.wait()
        try:
            os.link(home / f"draft{number}", home / "taken")
            winners.append(number)
        except FileExistsError:
            return
        except OSError as error:
            problems.append(error)

    racers = [threading.Thread(target=race, args=(number,)) for number in range(_RACERS)]
    for racer in racers:
        racer.start()
    for racer in racers:
        racer.join()
    if any(p.errno in durable.NO_HARD_LINKS for p in problems):
        return False, "this file system has no hard links, which publishing a version needs", _LOCAL
    if problems:
        raise problems[0]
    ok = len(winners) == 1 and (home / "taken").read_text() == str(winners[0])
    return ok, f"of {_RACERS} who linked one name at once, {len(winners)} got it", _LOCAL


def _fsync(home: Path) -> tuple[bool, str, str]:
    """Force a file and its folder to the disk."""
    path = home / "file"
    path.write_bytes(b"x" * 65536)
    begin = time.perf_counter()
    try:
        durable.sync(path)
        durable.sync(home)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
        return False, f"fsync is refused: {durable.reason(error)}", "a power loss may take what was acknowledged"
    return True, f"file and folder in {(time.perf_counter() - begin) * 1e3:.1f} ms", ""


def _clock(home: Path) -> tuple[bool, str, str]:
    """Compare the time a file is stamped with to the host's."""
    path = home / "file"
    path.write_bytes(b"")
    skew_s = path.stat().st_mtime - time.time()
    summary = f"the file system is {abs(skew_s):.1f} s {'ahead of' if skew_s > 0 else 'behind'} this host"
    return abs(skew_s) <= LARGEST_SKEW_S, summary, "set both clocks by NTP"


def _kill(folder: Path, kills: int, is_sound: bool) -> Probe:
    """Kill writers again and again, and count."""
    if not kills or not is_sound:
        return Probe("kill test", None, "left out" if is_sound else "left out: the folder lacks what it needs")
    home = folder / "kill-test"
    home.mkdir()
    try:
        result = kill_test(home, kills=kills)
    except (CandataError, OSError) as error:
        return Probe("kill test", False, " ".join(str(error).split()), "see what the process said")
    summary = (
        f"{result.kills} kills, 3 writers at once: {result.acknowledged} episodes acknowledged, {result.lost} lost, "
        f"{result.doubled} doubled, {len(result.damage)} files damaged"
    )
    return Probe("kill test", result.has_passed, summary, "" if result.has_passed else _LOCAL)


_PROBES = {
    "rename of files": _rename_file,
    "rename of folders": _rename_folder,
    "exclusive creation": _exclusive,
    "fsync": _fsync,
    "clock": _clock,
}
_REQUIRED_PROBES = ("write", "rename of folders", "exclusive creation")
