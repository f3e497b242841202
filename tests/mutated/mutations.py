"""Mutations of files: bits, runs, cuts, splices of two files, extreme lengths; numbers, words and nesting of text."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence

#: Whole numbers at which lengths, counts and offsets break, in the sizes that formats write them in [bytes].
_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)
_SIZES = (1, 2, 4, 8)
_FLOATS = (float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 1e-45)
_NUMBERS = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = re.compile(rb"[A-Za-z_]\w*")
#: What stands in place of a number or a word.
_NUMBER_TEXTS = (
    *(b"0", b"-1", b"1", b"2", b"1e999", b"-1e308", b"NaN", b".inf", b"-Infinity", b"0x1F", b"0o17", b"1:30", b"1_0"),
    *(b"9" * 30, b"9" * 5000, b"9223372036854775808", b"18446744073709551616", b"4294967296", b"1.5", b"1e-320"),
    *(b"true", b"null", b'"1"', b"[1]", b"{}", b""),
)
_WORD_TEXTS = (
    *(b"true", b"null", b"~", b"on", b"3", b"NaN", b"", b" ", b"\t", b"\x00", b"\xff", "ü".encode(), b"\xef\xbb\xbf"),
    *(
        b"*a",
        b"&a",
        b"<<",
        b"!!binary",
        b"!!python/none",
        b"---",
        b"#",
        b"'",
        b'"',
        b"\\ud800",
        b"\\u0000",
        b": ",
        b",",
    ),
    *(b"../..", b"/dev/null", b"x" * 300, b"[", b"]", b"{", b"}", b"- ", b"? "),
)
_WHITE = b" \t\r\n"


def mutated(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes with one to three mutations.

    Parameters
    ----------
    data : bytes
        A sound file.
    others : sequence of bytes
        Sound files of the same kind, for splices.
    rng : random.Random
        Draws.
    """
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kinds = _OF_TEXT if _is_text(data) and rng.random() < 0.75 else _OF_BYTES
        data = rng.choice(kinds)(data, others, rng)
    return data


def _is_text(data: bytes) -> bool:
    """Tell whether bytes are text, by their start."""
    return b"\0" not in data[:512] and bool(re.match(rb"[\s\x20-\x7e]*$", data[:512]))


def _span(data: bytes, rng: random.Random, most: int) -> tuple[int, int]:
    """Return where a run of at most `most` bytes begins and ends."""
    begin = rng.randrange(len(data) + 1)
    return begin, min(len(data), begin + rng.randint(1, most))


def _flip(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes of which one to four bits are flipped."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes in which a run is blank, full or random."""
    begin, end = _span(data, rng, 64)
    run = rng.choice((b"\0" * 64, b"\xff" * 64, rng.randbytes(64)))
    return data[:begin] + run[: end - begin] + data[end:]


def _cut(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return the start of bytes."""
    return data[: rng.randrange(len(data) + 1)]


def _leave_out(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes without a run."""
    begin, end = _span(data, rng, rng.choice((1, 8, 256)))
    return data[:begin] + data[end:]


def _repeat(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes in which a run stands twice."""
    begin, end = _span(data, rng, rng.choice((1, 8, 256)))
    return data[:end] + data[begin:end] + data[end:]


def _splice(data: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return the start of one file and the end of another, or one file with a run of another."""
    other = rng.choice(others or [data])
    if rng.random() < 0.5:
        return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]
    begin, end = _span(other, rng, 256)
    place = rng.randrange(len(data) + 1)
    return data[:place] + other[begin:end] + data[place + end - begin :]


def _extreme(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes in which a number at a place where lengths stand is extreme."""
    size, order = rng.choice(_SIZES), rng.choice("<>")
    value = rng.choice((*_EXTREMES, len(data), len(data) + 1))
    raw = struct.pack(f"{order}Q", value % 256**size)
    raw = raw[:size] if order == "<" else raw[8 - size :]
    if rng.random() < 0.2:
        raw = struct.pack(f"{order}{rng.choice('fd')}", rng.choice(_FLOATS))
    place = rng.randrange(max(len(data) - len(raw), 0) + 1)
    place -= place % len(raw) if rng.random() < 0.5 else 0
    return data[:place] + raw + data[place + len(raw) :]


def _renumber(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes in which one number in digits is another."""
    return _replaced(data, _NUMBERS, rng.choice(_NUMBER_TEXTS), rng)


def _reword(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return bytes in which one word is another, or one of the file's own."""
    own = _WORDS.findall(data[:100_000])
    text = rng.choice(own) if own and rng.random() < 0.4 else rng.choice(_WORD_TEXTS)
    return _replaced(data, _WORDS, text, rng)


def _replaced(data: bytes, pattern: re.Pattern[bytes], text: bytes, rng: random.Random) -> bytes:
    """Return bytes with a text in place of one match of a pattern."""
    matches = list(pattern.finditer(data[:100_000]))
    if not matches:
        return data
    match = rng.choice(matches)
    if not _is_text(data) and len(text) < len(match[0]):
        text = text.rjust(len(match[0]), b"0")  # lengths beside it stay right
    return data[: match.start()] + text + data[match.end() :]


def _nest(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return text in which a value is nested deep."""
    depth = rng.choice((1, 2, 70, 3000))
    opened, closed = rng.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"- ", b""), (b"{a: ", b"}"), (b"&a [*a, ", b"]")))
    return _replaced(data, rng.choice((_NUMBERS, _WORDS)), opened * depth + b"1" + closed * depth, rng)


def _lines(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return text in which a line stands twice, elsewhere, further in, or not at all."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines[at]
    match rng.randrange(5):
        case 0:
            lines.insert(to, line)
        case 1:
            lines[at], lines[to] = lines[to], line
        case 2:
            del lines[at]
        case 3:
            lines[at] = rng.choice((b" ", b"\t", b"  - ")) + line
        case _:
            lines[at] = line.lstrip(_WHITE)
    return b"".join(lines)


def _values(data: bytes, _others: Sequence[bytes], rng: random.Random) -> bytes:
    """Return text in which one value between commas stands many times, or a mark of structure is another."""
    marks = [m.start() for m in re.finditer(rb'[,:\[\]{}"]', data[:100_000])]
    if not marks:
        return data
    place = rng.choice(marks)
    if rng.random() < 0.5:
        return data[:place] + rng.choice((b"", b",", b":", b"[", b"]", b"{", b"}", b'"')) + data[place + 1 :]
    end = next((mark for mark in marks if mark > place), place + 1)
    return data[:end] + data[place:end] * rng.choice((1, 2, 300)) + data[end:]


#: What is done to bytes, `(bytes, others, rng) -> bytes`, and to text.
Mutation = Callable[[bytes, Sequence[bytes], random.Random], bytes]
_OF_BYTES: tuple[Mutation, ...] = (
    *(_flip, _flip, _overwrite, _cut, _leave_out, _repeat, _splice, _extreme, _extreme, _renumber, _reword),
)
_OF_TEXT: tuple[Mutation, ...] = (_renumber, _renumber, _reword, _reword, _nest, _lines, _values)
