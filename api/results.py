"""What a run left in its folder, read back lazily: tables, fields, values at places and along lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, unknown
from granfabric.cases.records import files, series
from granfabric.fem.discretisation.location import Locator

from .gone import ground_there

if TYPE_CHECKING:
    import pandas

__all__ = ["PointResults", "Results", "read_results"]

Array = NDArray[np.float64]

KEPT_FILES = 4
"""Files of fields that stay in memory."""

_SUFFIXES = {2: ("_x", "_y"), 3: ("_xx", "_yy", "_xy")}
_DOUBLE_ANGLE = ("_1", "_2")
_PLAIN_VECTORS = ("displacement", "principal_direction")


def read_results(folder: str | Path) -> Results:
    """Results of `granfabric run`, `point`, `dem`, or of `run_scene` and `solve_to_folder`.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Results

    Raises
    ------
    InputError
        If the folder holds no results.

    Examples
    --------
    >>> import granfabric as gf
    >>> results = gf.read_results(demo)
    >>> bool(results.history["coordination"].iloc[-1] < 4.06)
    True
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"there is no folder {str(folder)!r}")
    record = files.whole_record(folder)
    if record is None:
        raise InputError(f"the folder {str(folder)!r} holds no results: there is no whole {files.RECORD} in it")
    return Results(folder, record)


class _Series:
    """Files of one series of a field run, a step each."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name
        self.read = lru_cache(maxsize=KEPT_FILES)(self._read)

    @cached_property
    def steps(self) -> dict[int, Path]:
        """File of each step that was written."""
        return series.steps(self._folder, self._name)

    def number(self, step: int) -> int:
        """Number of a step; from the end if negative, as in a list of those written.

        Raises
        ------
        InputError
        """
        known = sorted(self.steps)
        if step < 0 and -len(known) <= step:
            return known[step]
        if step not in self.steps:
            some = ", ".join(map(str, known)) or "none"
            legal = some if len(known) < 12 else f"{known[0]} ... {known[-1]} in {len(known)} files"
            raise InputError(f"step {step} was not written to {self._folder / self._name}.pvd; there are {legal}")
        return step

    def _read(self, step: int) -> Any:
        return series.read(self.steps[step], required=())

    def at(self, step: int) -> Any:
        """Content of a step's file."""
        return self.read(self.number(step))

    def field(self, name: str, step: int) -> Array:
        """A field without what pads it for ParaView."""
        content = self.at(step)
        if name not in content.point_data:
            raise InputError(unknown("the field", name, list(content.point_data)))
        return _plain(name, np.asarray(content.point_data[name]))


def _plain(name: str, values: Array) -> Array:
    """Vectors with two components, tensors as xx, yy, xy; strain with engineering shear."""
    if values.ndim == 1:
        return values
    if values.shape[1] == 3:
        return values[:, :2]
    plain = values[:, [0, 4, 1]].copy()
    if name == "strain":
        plain[:, 2] *= 2.0
    return plain


def _columns(name: str, values: Array) -> Iterator[tuple[str, Array]]:
    """A field as columns of a table."""
    if values.ndim == 1:
        yield name, values
        return
    endings = _SUFFIXES[values.shape[1]]
    if values.shape[1] == 2 and not name.startswith(_PLAIN_VECTORS):
        endings = _DOUBLE_ANGLE
    for place, ending in enumerate(endings):
        yield name + ending, values[:, place]


class Results:
    """Results of one run; nothing is read before it is asked for.

    Attributes
    ----------
    folder : Path
    record : dict
        Content of `run.json`: scene as resolved, effects, versions, timing.
    """

    def __init__(self, folder: Path, record: dict[str, Any]) -> None:
        self.folder = folder
        self.record = record
        self._fields = _Series(folder, "result")
        self._points = _Series(folder, "points")
        self._kept: tuple[Array, NDArray[np.int64], Locator] | None = None

    def __repr__(self) -> str:
        return f"<{self.kind} results, {self.outcome}, in {str(self.folder)!r}>"

    @property
    def kind(self) -> str:
        """ "point", "field", "dem" or "specimen"."""
        return str(self.record["kind"])

    @property
    def outcome(self) -> str:
        """ "finished", "stopped", "failed", or "running" while it is or where it was killed."""
        return str(self.record["outcome"])

    @property
    def message(self) -> str:
        """How it ended, in a sentence."""
        return str(self.record["message"])

    @cached_property
    def history(self) -> pandas.DataFrame:
        """`history.csv`: a row each step; stress in Pa, tension positive, strain_xy the engineering shear strain."""
        import pandas

        return pandas.DataFrame(files.read_csv(self.folder / files.HISTORY))

    @property
    def steps(self) -> list[int]:
        """Numbers of the steps whose fields were written."""
        return sorted(self._fields.steps)

    @property
    def nodes(self) -> Array:
        """Nodes of the mesh at the last step, shape (nnodes, 2) [m]; where materials meet, once more for each."""
        return self.nodes_at(-1)

    def nodes_at(self, step: int) -> Array:
        """Nodes of what is there at a step, shape (nnodes, 2) [m]; others only where stages change the body."""
        return np.asarray(self._fields.at(step).points)[:, :2]

    def names(self, step: int = -1) -> list[str]:
        """Names of the fields at a step."""
        return list(self._fields.at(step).point_data)

    def field(self, name: str, step: int = -1) -> Array:
        """A field at the nodes of the mesh.

        Parameters
        ----------
        name : str
            "displacement", "stress", "strain", what is read off the stress ("p", "q", "stress_ratio",
            "principal_stress_major", "principal_direction_major", the same with "minor"), or a state variable of the
            law such as "coordination".
        step : int
            Number of the step, or from the end (-1 the last written).

        Returns
        -------
        ndarray, shape (nnodes,), (nnodes, 2) or (nnodes, 3)
            Tensors as xx, yy, xy, tension positive [Pa]; strain with the engineering shear; vectors of second
            harmonics in the double-angle plane. Where stages change the body, at the nodes of what is there at the step
            (`nodes_at`).

        Raises
        ------
        InputError
            If there is no such field or step.
        """
        return self._fields.field(name, step)

    @property
    def points(self) -> PointResults:
        """The integration points, where the law itself was evaluated."""
        return PointResults(self._points)

    def _locator(self, step: int) -> Locator:
        """Of the mesh of a step; kept from one step to the next as long as the mesh is the same."""
        content = self._fields.at(step)
        try:
            kind, cells = series.elements(content)
        except ValueError as error:
            raise InputError(f"{self.folder / 'result.pvd'}: {error}") from error
        nodes = np.asarray(content.points)[:, :2]
        if self._kept is None or not (np.array_equal(self._kept[0], nodes) and np.array_equal(self._kept[1], cells)):
            self._kept = (nodes, cells, Locator(nodes, kind, cells))
        return self._kept[2]

    def at(self, x: float, y: float, step: int = -1) -> dict[str, float]:
        """Values of all fields at a place, by the shape functions of its cell (curved sides included).

        Where materials meet, the values are those in one of them.

        Parameters
        ----------
        x, y : float
            [m].
        step : int
            As in `field`.

        Returns
        -------
        dict of str to float
            By the names of `along`.

        Raises
        ------
        InputError
            If the place lies outside of the mesh; where stages change the body also if nothing is there at the step,
            with the stage that took it away or adds it.
        """
        place = np.array([[x, y]], dtype=np.float64)
        if not self._is_there(place, step):
            if told := self._ground_there(place, step):
                raise InputError(f"({x:g}, {y:g}) lies in no ground at step {self._fields.number(step)}: {told}")
            nodes = self.nodes_at(step)
            low, high = nodes.min(axis=0), nodes.max(axis=0)
            raise InputError(
                f"({x:g}, {y:g}) lies outside of the mesh, which reaches from ({low[0]:g}, {low[1]:g}) to "
                f"({high[0]:g}, {high[1]:g})"
            )
        return {name: float(column[0]) for name, column in self._table(place, step).items()}

    def _is_there(self, place: Array, step: int) -> bool:
        return bool(self._locator(step).find(place)[0][0, 0] >= 0)

    def _ground_there(self, place: Array, step: int) -> str:
        """What other steps tell about a place at which nothing is at a step."""
        changes = self.record.get("body", [])
        if not changes or "stage" not in self.history:
            return ""
        stage_of = dict(zip(self.history["step"].astype(int).tolist(), self.history["stage"]))
        at = self._fields.number(step)
        return ground_there(stage_of, self.steps, at, lambda other: self._is_there(place, other), changes)

    def along(self, a: Sequence[float], b: Sequence[float], step: int = -1, number: int = 101) -> pandas.DataFrame:
        """Values of all fields along a straight line.

        Parameters
        ----------
        a, b : (float, float)
            Ends [m].
        step : int
            As in `field`.
        number : int
            Places, the ends included.

        Returns
        -------
        pandas.DataFrame
            Columns ``distance, x, y`` and one for each component (``displacement_x``, ``stress_xx``,
            ``fabric_anisotropy_1`` in the double-angle plane, ...); NaN where the line leaves the mesh.
        """
        import pandas

        start, end = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        if start.shape != (2,) or end.shape != (2,) or number < 2:
            raise InputError(f"a line needs two ends (x, y) and at least 2 places, not {a!r}, {b!r}, {number!r}")
        fraction = np.linspace(0.0, 1.0, number)
        places = start + fraction[:, None] * (end - start)
        distance = {"distance": fraction * float(np.linalg.norm(end - start)), "x": places[:, 0], "y": places[:, 1]}
        return pandas.DataFrame({**distance, **self._table(places, step)})

    def _table(self, places: Array, step: int) -> dict[str, Array]:
        nodes, weights = self._locator(step).find(places)
        table: dict[str, Array] = {}
        for name in self.names(step):
            values = self.field(name, step).astype(np.float64)
            at_nodes = values[nodes]
            found = np.einsum("pn,pn...->p...", weights, at_nodes)
            table |= dict(_columns(name, found))
        return table


class PointResults:
    """Integration points of a field run: the law's own values, not recovered ones."""

    def __init__(self, source: _Series) -> None:
        self._source = source

    @property
    def position(self) -> Array:
        """Where they lie at the last step, shape (npt, 2) [m]."""
        return self.position_at(-1)

    def position_at(self, step: int) -> Array:
        """Where those lie that are there at a step, shape (npt, 2) [m]."""
        return np.asarray(self._source.at(step).points)[:, :2]

    def field(self, name: str, step: int = -1) -> Array:
        """A field at the integration points; as `Results.field`."""
        return self._source.field(name, step)

    def table(self, step: int = -1) -> pandas.DataFrame:
        """All fields at the integration points, a row each, with x and y [m] first."""
        import pandas

        place = self.position_at(step)
        columns: dict[str, Array] = {"x": place[:, 0], "y": place[:, 1]}
        for name in self._source.at(step).point_data:
            columns |= dict(_columns(name, self.field(name, step)))
        return pandas.DataFrame(columns)
