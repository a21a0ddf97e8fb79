"""Reading a TOML file that a user gave."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError

LARGEST_FILE = 10_000_000
"""[byte] A scene written by hand has a few thousand; the largest path that the schema admits has less than this."""


def read_table(file: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises
    ------
    InputError
        If it cannot be read or is not TOML.
    """
    try:
        if file.exists() and not file.is_file():  # a device or a pipe may never end
            raise OSError(0, "it is a folder, a device or a pipe")
        size = file.stat().st_size
        if size > LARGEST_FILE:
            raise OSError(0, f"{size / 1e6:.0f} MB is more than the {LARGEST_FILE / 1e6:.0f} MB that a scene may have")
        return tomllib.loads(file.read_bytes().decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text in UTF-8 (byte {error.start})") from error
    except ValueError as error:  # tomllib's own error, and Python's on integers of thousands of digits
        raise InputError(f"{file}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{file}: not valid as a scene: tables nested too deeply") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error
