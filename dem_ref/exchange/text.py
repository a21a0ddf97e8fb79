"""Text files of other codes: lines with their numbers, and numbers of which a sentence can be said."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from granfabric.dem_ref.arrays import SampleError

COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd")
"""First bytes of compressed files."""
LONGEST_SHOWN = 40
MOST_LISTED = 12


@dataclass(frozen=True)
class TextFile:
    """A file as lines.

    Attributes
    ----------
    origin : str
        How the file is called in messages.
    lines : list of str
        Without line ends; line 1 is ``lines[0]``.
    """

    origin: str
    lines: list[str]

    def error(self, line: int, text: str) -> SampleError:
        """What is said about a line, counted from 1."""
        return SampleError(f"{self.origin}, line {line}: {text}")

    def number(self, token: str, line: int, name: str, positive: bool = False) -> float:
        """A finite number, or a sentence on file, line, name and value."""
        try:
            value = float(token)
        except ValueError:
            value = math.nan
            if "," in token:
                raise self.error(line, f"{name} = {shown(token)} is not a number; decimals need a point") from None
        if not math.isfinite(value) or "_" in token:
            raise self.error(line, f"{name} = {shown(token)} is not a finite number")
        if positive and not value > 0.0:
            raise self.error(line, f"{name} = {token} is not legal, legal are values > 0")
        return value

    def whole(self, token: str, line: int, name: str, low: int = -(2**62), high: int = 2**62) -> int:
        """A whole number; ``3.0`` is one."""
        value = self.number(token, line, name)
        if value != math.floor(value) or not low <= value <= high:
            legal = "whole numbers" if low < 0 else f"whole numbers from {low}"
            raise self.error(line, f"{name} = {shown(token)} is not legal, legal are {legal}")
        return int(value)

    def row(self, tokens: Sequence[str], line: int, names: Sequence[str]) -> None:
        """See that a row has as many entries as there are names."""
        if len(tokens) != len(names):
            raise self.error(
                line, f"{len(tokens)} entries where {len(names)} are wanted ({', '.join(names[:MOST_LISTED])})"
            )


def shown(token: str) -> str:
    """A token as it stands in a sentence."""
    return repr(token if len(token) <= LONGEST_SHOWN else token[: LONGEST_SHOWN - 3] + "...")


def read_text_file(path: str | Path) -> TextFile:
    """The lines of a text file.

    Raises
    ------
    SampleError
        If there is no such file, or it is no text in UTF-8.
    """
    origin = str(path)
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise SampleError(f"{origin}: no such file") from None
    except OSError as error:
        raise SampleError(f"{origin}: cannot be read ({error.strerror})") from None
    if data.startswith(COMPRESSED):
        raise SampleError(f"{origin}: is compressed; unpack it first")
    if b"\x00" in data[:4096]:
        raise SampleError(f"{origin}: is no text but a binary file; write it as text")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SampleError(f"{origin}, line {line}: not a text in UTF-8") from None
    # not splitlines(), which would split at form feeds and other rare characters as well
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return TextFile(origin, lines)


def significant_digits(token: str) -> int:
    """Digits of a number as it is written, leading zeros left out: 5 of ``0.012300e-4``, 3 of ``1.23``."""
    mantissa = token.lower().partition("e")[0].lstrip("+-")
    whole, _, decimals = mantissa.partition(".")
    return len((whole + decimals).lstrip("0"))
