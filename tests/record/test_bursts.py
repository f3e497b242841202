"""Bursts of a latency timer are told by their rhythm, at any rate; healthy streams, slow readers and losses are not."""

from __future__ import annotations

import numpy as np
import pytest

from candata.record.bursts import FEWEST, TIMER_S, Rhythm, comes_in_bursts, looks_timed, remedy, seen_rate_hz

TIMER_NS = round(1e9 * TIMER_S)
START = 1_760_000_000_123_456_789
#: Rates at which a device may send, none of them that of the timer or a whole part of it.
RATES = (20.0, 50.0, 60.0, 80.0, 83.0, 100.0, 125.0, 200.0, 333.0, 500.0, 1000.0)


def sent(rate_hz: float, seconds: float = 8.0, jitter_s: float = 0.0, seed: int = 3) -> np.ndarray:
    """When frames are whole on the wire: evenly, give or take so much."""
    rng = np.random.default_rng(seed)
    even = np.arange(round(seconds * rate_hz)) / rate_hz
    return START + np.round(1e9 * np.sort(even + jitter_s * rng.uniform(-1, 1, len(even)))).astype(np.int64)


def held(time_ns: np.ndarray, late_s: float = 0.0, seed: int = 4) -> np.ndarray:
    """When they are read behind an adapter that hands over what it has each time its timer runs out."""
    rng = np.random.default_rng(seed)
    ticks = -(-time_ns // TIMER_NS) * TIMER_NS
    return np.sort(ticks + np.round(1e9 * late_s * rng.uniform(0, 1, len(ticks))).astype(np.int64))


def by_a_held_up_reader(time_ns: np.ndarray, seed: int = 5) -> np.ndarray:
    """When they are read by a program that is held up a few times, for as long as a few frames."""
    rng = np.random.default_rng(seed)
    out = time_ns.copy()
    for begin in rng.uniform(0, 7.5, 8):
        first = START + round(1e9 * begin)
        waiting = (out >= first) & (out < first + 150_000_000)
        out[waiting] = first + 150_000_000
    return out


def told(read_ns: np.ndarray, rate_hz: float) -> bool:
    """What is told of reads, which must be the same while they come."""
    rates = (rate_hz, seen_rate_hz(read_ns))
    running = Rhythm()
    for stamp_ns in [*read_ns.tolist(), int(read_ns[-1]) + 3_000_000_000]:
        running.read(stamp_ns)
    found = comes_in_bursts(read_ns, rates)
    assert running.is_in_bursts(rates) == found
    return found


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_timer_is_noticed_at_any_rate(rate_hz):
    assert told(held(sent(rate_hz)), rate_hz)
    # A device that does not send evenly, a host that polls each millisecond and is late by some more.
    assert told(held(sent(rate_hz, jitter_s=0.002), late_s=0.004), rate_hz)


def test_a_period_that_is_longer_than_the_timers_is_noticed():
    read = held(sent(50.0))
    assert set(np.diff(read) // TIMER_NS) == {1, 2}
    assert told(read, 50.0)


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("jitter_s", [0.0, 0.0005, 0.002, 0.008])
def test_a_healthy_stream_is_none_whatever_its_jitter(rate_hz, jitter_s):
    assert not told(sent(rate_hz, jitter_s=jitter_s), rate_hz)


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_reader_that_is_held_up_now_and_then_is_none(rate_hz):
    assert not told(by_a_held_up_reader(sent(rate_hz, jitter_s=0.001)), rate_hz)


@pytest.mark.parametrize("rate_hz", RATES)
def test_frames_in_several_reads_are_none(rate_hz):
    # A request, a reply in two pieces, within half a period.
    pieces = (np.array([0, 0.3, 0.45]) * 1e9 / rate_hz).astype(np.int64)
    assert not told(np.sort((sent(rate_hz, jitter_s=0.0005)[:, None] + pieces).ravel()), rate_hz)


@pytest.mark.parametrize("rate_hz", [62.5, 31.25, 62.5 / 3])
def test_a_device_in_step_with_the_timer_is_not_told_apart_and_none(rate_hz):
    read = held(sent(rate_hz))
    assert len(np.unique(read % TIMER_NS)) == 1
    assert not told(read, rate_hz)
    # Nor where some of its frames are lost, so that the mean rate is another.
    rng = np.random.default_rng(6)
    assert not told(read[rng.uniform(size=len(read)) > 0.05], rate_hz)


@pytest.mark.parametrize("rate_hz", [50.0, 83.0, 200.0])
def test_another_beat_is_none(rate_hz):
    beat = 10_000_000  # a machine whose clock ticks a hundred times a second
    assert not told(-(-sent(rate_hz) // beat) * beat, rate_hz)


def test_lost_frames_do_not_hide_a_timer():
    rng = np.random.default_rng(7)
    read = held(sent(83.0))
    assert told(read[rng.uniform(size=len(read)) > 0.2], 83.0)


def test_a_recording_of_which_a_part_was_held_is_judged_by_its_larger_part():
    whole = sent(83.0, seconds=20.0)
    half = len(whole) // 4
    assert told(np.concatenate([whole[:half], held(whole[half:])]), 83.0)
    assert not told(np.concatenate([held(whole[:half]), whole[half:]]), 83.0)


def test_too_little_tells_nothing():
    assert not told(held(sent(83.0))[: FEWEST - 1], 83.0)
    assert not comes_in_bursts(np.zeros(0, np.int64), (83.0, 0.0))
    assert seen_rate_hz(np.zeros(1, np.int64)) == 0.0


def test_the_rates_at_which_nothing_can_be_told_are_narrow():
    rates = np.arange(10.0, 1000.0, 0.5)
    silent = [float(rate) for rate in rates if looks_timed(rate)]
    assert 62.5 in silent
    assert all(abs(1 / (rate * TIMER_S) - max(round(1 / (rate * TIMER_S)), 1)) < 0.04 for rate in silent)


@pytest.mark.parametrize(
    ("port", "name"), [("/dev/ttyUSB3", "ttyUSB3"), ("/dev/pts/4", "ttyUSB0"), ("/tmp/hand", "ttyUSB0")]
)
def test_the_remedy_names_the_port(port, name):
    assert remedy(port) == (
        f"echo 1 > /sys/bus/usb-serial/devices/{name}/latency_timer (as root), or setserial /dev/{name} low_latency, "
        "and record again"
    )


def test_a_link_to_a_port_is_followed(tmp_path):
    (tmp_path / "ttyUSB7").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB7")
    assert "/dev/ttyUSB7 low_latency" in remedy(str(tmp_path / "by-id"))
