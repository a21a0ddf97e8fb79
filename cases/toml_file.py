"""Reading a TOML file that a user gave."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from .errors import InputError


def read_table(file: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises
    ------
    InputError
        If it cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text in UTF-8 (byte {error.start})") from error
    except ValueError as error:  # tomllib's own error, and Python's on integers of thousands of digits
        raise InputError(f"{file}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{file}: not valid as a scene: tables nested too deeply") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error
