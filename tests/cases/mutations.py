"""Random damage to files: what a bad disk, a bad editor or a bad person does to them."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
TOKEN = re.compile(rb"[^\s,=\[\]{}\"]+")
HUGE = (
    *(b"99999999999999999999", b"-1", b"0", b"1e999", b"-1e308", b"1e-320", b"nan", b"inf", b"4294967296"),
    *(b"2147483648", b"9223372036854775807", b"18446744073709551615", b"1" * 400, b"1_000_000_000", b"1000000000"),
    *(
        b"true",
        b'""',
        b"[]",
        b"{}",
        b"0x7f",
        b"1979-05-27",
        b"'''",
        b"$",
        b"\x00",
        b"\xff\xfe",
        b"../../x",
        b"\xc3\xa9",
    ),
)


class Hang(BaseException):
    """Nobody catches it."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Break off what takes longer: a hang is a failure of its own."""

    def ring(number: int, frame: object) -> None:
        raise Hang(f"still at work after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for place in rng.integers(0, len(data), rng.integers(1, 4)):
        out[place] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def _overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    place, size = int(rng.integers(0, len(data))), int(rng.integers(1, 32))
    return data[:place] + rng.bytes(min(size, len(data) - place)) + data[place + size :]


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(0, len(data)))]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(0, len(data)))
    return data[:place] + data[place + int(rng.integers(1, 200)) :]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    place, size = int(rng.integers(0, len(data))), int(rng.integers(1, 200))
    return data[: place + size] + data[place:]


def _replace_one(pattern: re.Pattern[bytes], data: bytes, rng: np.random.Generator, by: bytes) -> bytes:
    found = [match.span() for match in pattern.finditer(data)]
    if not found:
        return data
    start, end = found[int(rng.integers(0, len(found)))]
    return data[:start] + by + data[end:]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    """A number becomes another: huge, negative, not finite, or no number at all."""
    return _replace_one(NUMBER, data, rng, HUGE[int(rng.integers(0, len(HUGE)))])


def _count(data: bytes, rng: np.random.Generator) -> bytes:
    """A number changes by little: a count that is off by one."""
    found = [match for match in NUMBER.finditer(data) if match[0].isdigit()]
    if not found:
        return data
    match = found[int(rng.integers(0, len(found)))]
    return data[: match.start()] + str(int(match[0][:18]) + int(rng.integers(-2, 3))).encode() + data[match.end() :]


def _swap(data: bytes, rng: np.random.Generator) -> bytes:
    """Two tokens change places."""
    found = [match.span() for match in TOKEN.finditer(data)]
    if len(found) < 2:
        return data
    a, b = sorted(int(i) for i in rng.choice(len(found), 2, replace=False))
    (s, e), (t, f) = found[a], found[b]
    return data[:s] + data[t:f] + data[e:t] + data[s:e] + data[f:]


def _drop_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    del lines[int(rng.integers(0, len(lines)))]
    return b"".join(lines)


def _move_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    line = lines.pop(int(rng.integers(0, len(lines))))
    lines.insert(int(rng.integers(0, len(lines) + 1)), line)
    return b"".join(lines)


ANY: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (_flip, _overwrite, _truncate, _cut, _repeat)
TEXT = (*ANY, _number, _number, _count, _count, _swap, _swap, _drop_line, _move_line)


def mutated(data: bytes, rng: np.random.Generator, text: bool = True) -> bytes:
    """`data` with one to three kinds of damage; never the same as before unless by chance."""
    kinds = TEXT if text else ANY
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        if data:
            data = kinds[int(rng.integers(0, len(kinds)))](data, rng)
    return data


def one_sentence(text: str) -> bool:
    """Whether this is what a refusal says: a line for each error, that begins with the program's name; no traceback."""
    lines = text.split("\n")
    whole = len(lines) > 1 and not lines.pop() and all(line.startswith("granfabric: ") for line in lines)
    return whole and "Traceback" not in text and max(map(len, lines)) < 2000
