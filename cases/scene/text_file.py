"""Texts that a user gave: UTF-8, with or without a byte order mark, with the line ends of any system."""

from __future__ import annotations

import codecs
from pathlib import Path

from granfabric.cases.errors import InputError

MARKS = (
    (codecs.BOM_UTF32_LE, "UTF-32"),
    (codecs.BOM_UTF32_BE, "UTF-32"),
    (codecs.BOM_UTF16_LE, "UTF-16"),
    (codecs.BOM_UTF16_BE, "UTF-16"),
)
"""First bytes of texts in other encodings; the longer ones first, because one begins like another."""

REMEDY = "save it as UTF-8 (in Notepad: Save as, Encoding; in PowerShell: Out-File -Encoding utf8)"


class EncodingError(InputError):
    """A text is not in UTF-8; the sentence says what it is in, as far as that can be told."""


def decoded(data: bytes, file: Path) -> str:
    """The text of a file; a byte order mark is left out, line ends become one character.

    Raises
    ------
    EncodingError
        Naming the file, what it seems to be saved as, and what to do.
    """
    for mark, name in MARKS:
        if data.startswith(mark):
            raise EncodingError(f"{file}: saved as {name}, which is not read; {REMEDY}")
    head = data[:200]
    if head.count(0) > len(head) // 3:  # every second byte of a text in Latin letters
        raise EncodingError(f"{file}: not a text in UTF-8, but perhaps in UTF-16 without a mark; {REMEDY}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise EncodingError(
            f"{file}: not a text in UTF-8 (line {line}, byte {error.start}), perhaps in Windows-1252 or Latin-1; "
            f"{REMEDY}"
        ) from error
    return text.replace("\r\n", "\n")


def read_text(file: Path) -> str:
    """The text of a file.

    Raises
    ------
    EncodingError
    OSError
    """
    return decoded(file.read_bytes(), file)
