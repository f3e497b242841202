"""What the recorder loses and costs with four streams at once: hand 83 Hz, arm 200 Hz, pose 15 Hz, wrench 100 Hz.

    python benchmarks/recorder_streams.py --seconds 60 --kills 5 --busy

One process sends numbered frames of all four, on pseudo-terminals, TCP and UDP, and notes when. Lost frames are the
numbers that are missing between the first and the last in the log. The error of a stamp is the log's against the
sender's, in which a serial frame began its time on the wire before its last byte was written. CPU is that of recorder
and readers together between the first seconds and the last. Lost time is from the last frame in the log to the last
one sent before recorder and readers were killed, of the worst stream.
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from busy_machine import busy, wait_for

from candata.record.devices import hand, stream
from candata.record.devices._wire import wire_time_ns
from candata.record.emulate_streams import SerialOutlet
from candata.record.log_streams import LoggedStream
from candata.record.logs import Log, read_log

RATES_HZ = {"hand": 83.0, "arm": 200.0, "pose": 15.0, "wrench": 100.0}
#: Frames are numbered by a joint's angle, the device's clock or a force, in these steps; a force starts anew at WRAP.
ANGLE_STEP_RAD, FORCE_STEP_N, WRAP = 1e-4, 0.01, 30_000
#: Seconds of a recording before CPU is counted: imports are no running cost.
WARM_S = 5.0


def period_ns(name: str) -> int:
    """Return the period of a stream [ns]."""
    return round(1e9 / RATES_HZ[name])


def frames_of(name: str) -> Iterator[tuple[bytes, int]]:
    """Yield the bytes of frame 0, 1, 2 and their time on the wire after the first byte of the (state) frame [ns]."""
    number = 0
    while True:
        yield _FRAME[name](number)
        number += 1


def _hand_frame(number: int) -> tuple[bytes, int]:
    device = hand("xhand")
    encoder = device.encoder
    if encoder is None:
        raise SystemExit("xhand cannot be emulated")
    joints, tips = len(device.joint_names), len(device.fingertip_names)
    position = np.zeros((1, joints))
    position[0, 0] = number * ANGLE_STEP_RAD
    state = encoder.state_frames(position, np.zeros((1, tips, 3), int), np.zeros((1, tips, device.taxels, 3), int))[0]
    return encoder.command_frames(position)[0] + state, wire_time_ns(len(state), device.baud)


def _stream_frame(device_name: str, name: str, number: int) -> tuple[bytes, int]:
    device = stream(device_name)
    values = {s.name: np.zeros((1, *s.shape)) for s in device.signals}
    if "device_time" in values:
        values["device_time"] = np.array([number * period_ns(name)])
    if "object_pose" in values:
        values["object_pose"][0, 3] = 1.0
    if "wrench" in values:
        values["wrench"][0, 0] = (number % WRAP) * FORCE_STEP_N
    if device.encode is None:
        raise SystemExit(f"{device_name} cannot be emulated")
    frame = device.encode(values)[0]
    return frame, wire_time_ns(len(frame), device.baud) if device.baud else 0


_FRAME: dict[str, Callable[[int], tuple[bytes, int]]] = {
    "hand": _hand_frame,
    "arm": lambda number: _stream_frame("xarm", "arm", number),
    "pose": lambda number: _stream_frame("pose_lines", "pose", number),
    "wrench": lambda number: _stream_frame("ft300", "wrench", number),
}


@dataclass
class Outgoing:
    """Where a stream goes: `send` returns whether all bytes of a frame were taken."""

    send: Callable[[bytes], bool]
    numbers: list[int] = field(default_factory=list)
    begin_ns: list[int] = field(default_factory=list)


def send_all(folder: Path) -> None:
    """Send until SIGTERM; then write which numbers went out whole, and when their frames began."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _frame: ended.append(number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    server = socket.create_server(("127.0.0.1", 0))
    server.setblocking(False)
    udp, udp_port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), _free_udp_port()
    udp.connect(("127.0.0.1", udp_port))
    outgoing = {
        "hand": Outgoing(_pty(folder / "hand")),
        "arm": Outgoing(_clients(server)),
        "pose": Outgoing(_datagrams(udp)),
        "wrench": Outgoing(_pty(folder / "wrench")),
    }
    places = {"arm": f"127.0.0.1:{server.getsockname()[1]}", "pose": f"udp://127.0.0.1:{udp_port}"}
    (folder / "places.part").write_text(json.dumps(places))
    (folder / "places.part").rename(folder / "places.json")
    begin_ns = time.monotonic_ns()
    frames = {name: frames_of(name) for name in outgoing}
    due = [(begin_ns, name, 0) for name in outgoing]
    heapq.heapify(due)
    while not ended:
        at_ns, name, number = heapq.heappop(due)
        data, wire_ns = next(frames[name])
        time.sleep(max(0, at_ns - time.monotonic_ns()) * 1e-9)
        sent_ns = time.monotonic_ns()
        if outgoing[name].send(data):
            outgoing[name].numbers.append(number)
            outgoing[name].begin_ns.append(sent_ns - wire_ns)
        heapq.heappush(due, (begin_ns + (number + 1) * period_ns(name), name, number + 1))
    arrays = {f"{name}_{key}": getattr(out, key) for name, out in outgoing.items() for key in ("numbers", "begin_ns")}
    np.savez(folder / "sent.npz", **{key: np.array(values, np.int64) for key, values in arrays.items()})


def _pty(link: Path) -> Callable[[bytes], bool]:
    outlet = SerialOutlet(link)
    return lambda data: outlet.write(data) == len(data)


def _clients(server: socket.socket) -> Callable[[bytes], bool]:
    """Send to the newest client; the ones before it are gone."""
    clients: list[socket.socket] = []

    def send(data: bytes) -> bool:
        try:
            client, _ = server.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            clients[:] = [client]
        except BlockingIOError:
            pass
        try:
            return bool(clients) and clients[0].send(data) == len(data)
        except OSError:
            clients.clear()
            return False

    return send


def _datagrams(out: socket.socket) -> Callable[[bytes], bool]:
    def send(data: bytes) -> bool:
        try:
            return out.send(data) == len(data)
        except OSError:
            return False

    return send


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def senders(folder: Path) -> Iterator[list[str]]:
    """Yield the options of `record-real` that name what is sent; `folder/sent.npz` stands once it is left."""
    folder.mkdir(parents=True)
    process = subprocess.Popen([sys.executable, __file__, "--send", str(folder)])
    try:
        wait_for((folder / "places.json").exists, 60, "the sender did not start")
        places = json.loads((folder / "places.json").read_text())
        yield [
            *("--port", str(folder / "hand"), "--wrench", str(folder / "wrench")),
            *("--arm", places["arm"], "--pose", places["pose"]),
        ]
    finally:
        process.terminate()
        process.wait(60)


def recorder(options: list[str], log: Path, *more: str) -> subprocess.Popen:
    """Return a running recorder."""
    command = [sys.executable, "-m", "candata_cli.main", "record-real", *options, "--out", str(log), "--no-calibrate"]
    return subprocess.Popen([*command, *more], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def family(process: subprocess.Popen) -> list[int]:
    """Return the process ids of a recorder and its readers."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [process.pid, *map(int, children)]


def cpu_s(pids: list[int]) -> float:
    """Return the CPU time that living processes used so far [s]."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def numbers_in(name: str, source: Log | LoggedStream) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the frames in a log, and their stamps [unix ns]."""
    if isinstance(source, Log):
        return np.round(source.joint_position[:, 0] / ANGLE_STEP_RAD).astype(np.int64), source.state_time_ns
    if name == "wrench":
        force = np.round(source.values["wrench"][:, 0] / FORCE_STEP_N).astype(np.int64)
        return force, source.time_ns
    if source.device_time_ns is None:
        raise SystemExit(f"{name} has no clock in the log")
    return np.round(source.device_time_ns / period_ns(name)).astype(np.int64), source.time_ns


def compare(folder: Path, log: Log) -> dict[str, dict[str, float]]:
    """Return, for each stream, frames sent and lost between the first and the last logged, and errors of stamps."""
    results = {}
    streams = {s.meta.name: s for s in log.streams}
    with np.load(folder / "sent.npz") as sent:
        for name in RATES_HZ:
            sent_numbers = sent[f"{name}_numbers"]
            begin_ns = sent[f"{name}_begin_ns"] + log.meta.wall_offset_ns
            numbers, stamps_ns = numbers_in(name, log if name == "hand" else streams[name])
            if name == "wrench":  # numbers start anew: the nearest of the sender's by time is meant
                nearest = sent_numbers[np.clip(np.searchsorted(begin_ns, stamps_ns), 0, len(begin_ns) - 1)]
                numbers = numbers + WRAP * np.round((nearest - numbers) / WRAP).astype(np.int64)
            inside = (sent_numbers >= numbers[0]) & (sent_numbers <= numbers[-1])
            _, in_log, in_sent = np.intersect1d(numbers, sent_numbers, return_indices=True)
            error_ms = np.abs(stamps_ns[in_log] - begin_ns[in_sent]) / 1e6
            results[name] = {
                "sent": int(inside.sum()),
                "lost": int(inside.sum()) - len(in_log),
                "unsent": int(sent_numbers[inside].max() - sent_numbers[inside].min() + 1 - inside.sum()),
                "p50_ms": float(np.median(error_ms)),
                "p99_ms": float(np.percentile(error_ms, 99)),
            }
    return results


def steady(folder: Path, seconds: float, beside_busy_core: bool) -> None:
    """Print what one recording of all streams lost and cost."""
    log = folder / "log.mcap"
    with senders(folder / "send") as options, busy() if beside_busy_core else nullcontext():
        process = recorder(options, log, "--duration", str(seconds), "--json")
        wait_for(lambda: log.exists() and log.stat().st_size > 100_000, 60, "the recorder wrote nothing")
        time.sleep(WARM_S)
        begin_s, begin_cpu_s = time.monotonic(), cpu_s(family(process))
        time.sleep(max(1.0, seconds - WARM_S - 3.0))
        share = (cpu_s(family(process)) - begin_cpu_s) / (time.monotonic() - begin_s)
        report = json.loads(process.communicate()[0])
    results = compare(folder / "send", read_log(log))
    where = "beside a busy core" if beside_busy_core else "without a busy core"
    print(f"{report['duration_s']:.1f} s of four streams {where}: CPU {100 * share:.1f} % of a core (target 25 %)")
    for name, result in results.items():
        print(
            f"  {name:<7}{result['lost']} of {result['sent']} frames lost (target 0), {result['unsent']} not taken by "
            f"the port; stamps off by {result['p50_ms']:.3f} ms p50 (target 1), {result['p99_ms']:.3f} ms p99"
        )
    facts = report["streams"] | {"hand": report}
    print("  gaps:", ", ".join(f"{name} {facts[name]['gaps']}" for name in RATES_HZ))


def killed(folder: Path, kills: int, rng: np.random.Generator) -> None:
    """Print the seconds that kills lost of the worst stream."""
    logs, killed_ns = [folder / f"kill{k}.mcap" for k in range(kills)], []
    with senders(folder / "send") as options:
        for log in logs:
            process = recorder(options, log, "--plain")
            wait_for(lambda log=log: log.exists() and log.stat().st_size > 100_000, 60, "the recorder wrote nothing")
            time.sleep(rng.uniform(1.0, 3.0))
            pids, at_ns = family(process), time.monotonic_ns()
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
            process.communicate()
            killed_ns.append(at_ns)
    lost_s = {
        name: [lost_time(folder / "send", log, at, name) for log, at in zip(logs, killed_ns, strict=True)]
        for name in RATES_HZ
    }
    for name, values in lost_s.items():
        print(
            f"  {name:<7}lost on SIGKILL: at most {max(values):.3f} s, median {np.median(values):.3f} s (target 0.3 s)"
        )


def lost_time(folder: Path, path: Path, at_ns: int, name: str) -> float:
    """Return the seconds from the last frame in a log to the last one sent before the kill."""
    log = read_log(path)
    streams = {s.meta.name: s for s in log.streams}
    last_ns = numbers_in(name, log if name == "hand" else streams[name])[1][-1] - log.meta.wall_offset_ns
    with np.load(folder / "sent.npz") as sent:
        begin_ns = sent[f"{name}_begin_ns"]
    return max(0.0, (begin_ns[begin_ns <= at_ns][-1] - last_ns) / 1e9)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the recording; 0: none")
    parser.add_argument("--busy", action="store_true", help="keep another core busy meanwhile")
    parser.add_argument("--kills", type=int, default=5, help="number of kills")
    parser.add_argument("--seed", type=int, default=1, help="draws the moments of the kills")
    parser.add_argument("--send", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.send:
        send_all(args.send)
        return
    with tempfile.TemporaryDirectory() as name:
        if args.seconds > 0:
            steady(Path(name) / "steady", args.seconds, args.busy)
        if args.kills > 0:
            print(f"{args.kills} kills:")
            killed(Path(name) / "kills", args.kills, np.random.default_rng(args.seed))


if __name__ == "__main__":
    main()
