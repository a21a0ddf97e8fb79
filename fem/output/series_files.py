"""`result.pvd` and `points.pvd`: which file holds which time."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

FIELDS = "result"
POINTS = "points"

_Series = list[tuple[float, str]]


class OutputError(ValueError):
    """Results cannot be written; the text names the folder and the reason."""


def file_name(series: str, step: int, ending: str = ".vtu") -> str:
    """File of a step, `.vtu` or, of several pieces, `.pvtu`."""
    return f"{series}_{step:04d}{ending}"


def piece_name(series: str, step: int, piece: int) -> str:
    """File of a piece of a step."""
    return f"{series}_{step:04d}_{piece}.vtu"


def pieces_of(file: Path) -> list[Path]:
    """Files of the pieces that a `.pvtu` of a series names.

    Raises
    ------
    ValueError
        If it is no such file, or names something else.
    OSError
    """
    try:
        sources = [entry.attrib["Source"] for entry in ElementTree.parse(file).getroot().iter("Piece")]
    except (ElementTree.ParseError, KeyError) as error:
        raise ValueError(f"{file} is damaged") from error
    for source in sources:
        if not re.fullmatch(rf"{re.escape(file.stem)}_\d{{1,9}}\.vtu", source):  # never a file elsewhere
            raise ValueError(f"{file} is damaged: it names {source!r}")
    return [file.with_name(source) for source in sources]


class SeriesFiles:
    """Both series of a run. A `.pvd` is replaced in one move, so that what it names can always be read.

    Parameters
    ----------
    folder : str or Path
        Created if missing.
    keep : callable, optional
        Going on with a run: told a step's number, whether its files and its entry in the series are kept. Without it
        the series begin anew.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """

    def __init__(self, folder: str | Path, keep: Callable[[int], bool] | None = None) -> None:
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / ".writable"
            probe.write_text("")
            probe.unlink()
        except OSError as error:
            raise OutputError(f"output folder {self.folder} cannot be written: {error.strerror or error}") from None
        # both are read before either is changed
        existing = {name: self._existing(name, keep) for name in (FIELDS, POINTS)}
        for name, (series, kept) in existing.items():
            if kept != series:
                self._write(name, kept)
                for _, file in set(series) - set(kept):
                    self._remove(self.folder / file)
        self._series = {name: kept for name, (_, kept) in existing.items()}

    def _remove(self, file: Path) -> None:
        if file.suffix == ".pvtu" and file.is_file():
            try:
                pieces = pieces_of(file)
            except ValueError:
                pieces = []
            for piece in pieces:
                piece.unlink(missing_ok=True)
        file.unlink(missing_ok=True)

    def _existing(self, name: str, keep: Callable[[int], bool] | None) -> tuple[_Series, _Series]:
        """Entries of a series on disk, and those of them to keep."""
        path = self.folder / f"{name}.pvd"
        if keep is None or not path.is_file():
            return [], []
        try:
            entries = ElementTree.parse(path).getroot().iter("DataSet")
            series = [(float(entry.attrib["timestep"]), entry.attrib["file"]) for entry in entries]
            for _, file in series:
                if not re.fullmatch(rf"{name}_\d{{1,9}}\.p?vtu", file):  # never a file elsewhere
                    raise ValueError(f"{file!r} is no file of this series")
            kept = [(time, file) for time, file in series if keep(int(Path(file).stem.rpartition("_")[2]))]
        except (ElementTree.ParseError, KeyError, ValueError):
            raise OutputError(f"{path} is damaged; remove it or choose another output folder") from None
        for _, file in kept:
            if not (self.folder / file).is_file():
                raise OutputError(f"{path} names {file}, which is gone; choose another output folder")
        return series, kept

    def add(self, name: str, time: float, file: str) -> None:
        """A file that is complete now.

        Raises
        ------
        OSError
        """
        series = [entry for entry in self._series[name] if entry[1] != file]
        series.append((time, file))
        self._series[name] = series
        self._write(name, series)

    def _write(self, name: str, series: _Series) -> None:
        lines = [f'    <DataSet timestep="{stamp!r}" part="0" file={quoteattr(entry)}/>' for stamp, entry in series]
        text = "\n".join(
            ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>", *lines]
            + ["  </Collection>", "</VTKFile>", ""]
        )
        hidden = self.folder / f".{name}.pvd"
        hidden.write_text(text)
        os.replace(hidden, self.folder / f"{name}.pvd")
