"""A crew of Ray workers: the tasks of a run on the machines of a cluster, or on this one as a cluster of one."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from candata import __version__
from candata.errors import CandataError, MissingExtraError, SetupError
from candata.simulate.crew import Crew, local

T = TypeVar("T")
#: Address that means a cluster of this machine alone, started for the run and ended with it.
LOCAL = "local"
#: How often a task is begun anew on another worker when its worker died.
RETRIES = 3
#: How long an open port may take to accept, and a cluster to take a first driver in [s]. Ray itself waits for minutes.
ANSWER_S, JOIN_S = 5.0, 60.0
#: How long each machine may take to start a first worker and look for the shared folder [s].
LOOK_S = 300.0
#: Memory for what tasks return [bytes], near the least that Ray takes: results are a few kilobytes.
STORE_BYTES = 100_000_000


@contextmanager
def crew_of(jobs: int, ray: str | None, shared: Path) -> Iterator[Crew]:
    """Yield who does the work: processes of this machine, or where an address is given a Ray cluster, as `on_ray`."""
    if ray is None:
        yield local(jobs)
        return
    with on_ray(ray, shared.resolve(), jobs) as crew:
        yield crew


@contextmanager
def on_ray(address: str, shared: Path, jobs: int = 1) -> Iterator[Crew]:
    """Yield a crew whose tasks run on a Ray cluster; a task whose worker died is begun anew on another.

    Parameters
    ----------
    address : str
        `local` for a cluster of this machine alone; `auto`, `HOST:PORT` or `ray://HOST:PORT` for one that runs.
    shared : Path
        Folder that every machine of the cluster must see under the same path; made if it is not there.
    jobs : int
        Tasks at a time, for `local`; a cluster that runs gives all its cores.

    Raises
    ------
    MissingExtraError
        When Ray is not installed.
    SetupError
        When the cluster cannot be reached, has no cores, or has a machine that does not see the folder or holds
        another candata.
    """
    try:
        import ray
    except ImportError:
        raise MissingExtraError("ray", "cluster") from None
    joined = ray.is_initialized()
    if not joined:
        _join(ray, address, jobs)
    try:
        _check_machines(ray, shared)
        yield _crew(ray)
    finally:
        if not joined:
            ray.shutdown()


def _join(ray: Any, address: str, jobs: int) -> None:
    """Start a cluster of this machine, or join one that runs."""
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address == LOCAL:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a run tells nobody that it happened
        os.environ.setdefault("RAY_worker_niceness", "0")  # Ray's 15 would starve it beside any other work
        ray.init(LOCAL, num_cpus=jobs, include_dashboard=False, object_store_memory=STORE_BYTES, **quiet)
        return
    _knock(address)
    try:
        ray.init(address, **quiet)
    except (ConnectionError, RuntimeError, ValueError, ImportError) as error:
        raise _unreachable(address, str(error)) from None


def _knock(address: str) -> None:
    """Make sure that a cluster answers: joining one that is not there would wait for minutes and end the process."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        try:
            socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
        except (OSError, OverflowError) as error:
            raise _unreachable(address, str(error)) from None
    trial = "import ray, sys; ray.init(sys.argv[1], log_to_driver=False)"
    try:
        done = subprocess.run([sys.executable, "-c", trial, address], capture_output=True, text=True, timeout=JOIN_S)
    except subprocess.TimeoutExpired:
        raise _unreachable(address, f"no Ray cluster answered within {JOIN_S:g} s") from None
    if done.returncode:
        raise _unreachable(address, (done.stderr.strip() or "no answer").splitlines()[-1])


def _unreachable(address: str, reason: str) -> SetupError:
    """Return the error of a cluster that cannot be joined."""
    return SetupError(
        f"the Ray cluster at {address} cannot be joined",
        expected="a cluster that runs: local, auto, HOST:PORT or ray://HOST:PORT",
        found=(reason.strip() or "no answer").splitlines()[0],
        fix="start one with `ray start --head`, or run on this machine with `--ray local` or `--jobs`",
    )


def _check_machines(ray: Any, shared: Path) -> None:
    """Refuse a cluster without cores, and one with a machine that could not do the tasks."""
    nodes = [n for n in ray.nodes() if n["Alive"] and n["Resources"].get("CPU", 0) >= 1]
    if not nodes:
        raise SetupError("the Ray cluster has no cores", fix="start its machines with `ray start --num-cpus N`")
    shared.mkdir(parents=True, exist_ok=True)
    token = shared / f".seen-{uuid.uuid4().hex[:8]}"
    token.touch()
    try:
        looks = {_look_from(ray, n, token): n for n in nodes}
        _, silent = ray.wait(list(looks), num_returns=len(looks), timeout=LOOK_S)
        if silent:
            raise SetupError(f"{_name(looks[silent[0]])} of the Ray cluster does not start a worker")
        for ref, node in looks.items():
            _check_machine(_result(ray, ref), _name(node), shared)
    finally:
        token.unlink(missing_ok=True)


def _look_from(ray: Any, node: dict[str, Any], token: Path) -> Any:
    """Return the promise of what one machine sees, however busy it is."""
    there = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
    look = ray.remote(look_at).options(num_cpus=0, max_retries=RETRIES, scheduling_strategy=there)
    return look.remote(str(token))


def look_at(token: str) -> tuple[bool, str]:
    """Return whether a file is seen from here, and candata's version here; runs on any machine."""
    return Path(token).exists(), __version__


def _check_machine(found: tuple[bool, str], name: str, shared: Path) -> None:
    """Refuse a machine that does not see the folder, or holds another candata."""
    seen, version = found
    if not seen:
        raise SetupError(
            f"{name} of the Ray cluster does not see {shared}",
            expected="a folder that all its machines share",
            fix="give an --out (or --cache-dir) on a shared folder, mounted at the same path everywhere",
        )
    if version != __version__:
        raise SetupError(f"{name} of the Ray cluster holds another candata", expected=__version__, found=version)


def _name(node: dict[str, Any]) -> str:
    """Return what to call a machine."""
    return f"machine {node.get('NodeManagerHostname') or node['NodeID']}"


def _crew(ray: Any) -> Crew:
    """Return the crew of the cluster that was joined."""

    def crew(work: Callable[..., T], tasks: Sequence[tuple[Any, ...]]) -> Generator[T, None, None]:
        task = ray.remote(work).options(num_cpus=1, max_retries=RETRIES)
        waiting = [task.remote(*one) for one in tasks]
        try:
            while waiting:
                (done,), waiting = ray.wait(waiting)
                yield _result(ray, done)
        finally:
            for left in waiting:
                ray.cancel(left)

    return crew


def _result(ray: Any, ref: Any) -> Any:
    """Return what a task returned.

    Raises
    ------
    CandataError
        What the task itself raised, or that it could not be done.
    """
    try:
        return ray.get(ref)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, CandataError):
            raise error.cause from None
        if isinstance(error.cause, ImportError):
            raise SetupError(
                f"a Ray worker cannot run candata: {error.cause}", fix="install the same candata on every machine"
            ) from None
        raise
    except ray.exceptions.RayError as error:
        raise SetupError(
            f"{RETRIES + 1} Ray workers died of one task, or the cluster is gone",
            found=str(error).splitlines()[0],
            fix="look at its memory; the same command goes on where this one stopped",
        ) from None
