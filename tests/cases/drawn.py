"""What goes to the axes of a picture: arrays, labels, units, legends; to be compared with what should."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex


def words(axes: Any) -> tuple[str, str, str]:
    """Title, label of the abscissa, label of the ordinate."""
    title = next((axes.get_title(loc=where) for where in ("left", "center", "right") if axes.get_title(loc=where)), "")
    return title, axes.get_xlabel(), axes.get_ylabel()


def curves(axes: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """x and y of every line with a label of its own."""
    found = {}
    for line in axes.get_lines():
        label = line.get_label()
        if not label.startswith("_"):
            assert label not in found, f"two curves are called {label!r}"
            found[label] = np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)
    return found


def unnamed(axes: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """x and y of the other lines, in the order in which they were drawn."""
    return [
        (np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float))
        for line in axes.get_lines()
        if line.get_label().startswith("_")
    ]


def bands(axes: Any) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Label, x, lower and upper border of every area that `fill_between` drew."""
    found = []
    for collection in axes.collections:
        if not isinstance(collection, PolyCollection) or len(collection.get_paths()) != 1:
            continue
        # one ring of vertices: along one border forwards and along the other back
        vertices = collection.get_paths()[0].vertices
        x = np.unique(vertices[:, 0])
        at = [vertices[np.abs(vertices[:, 0] - place) < 1e-12 * max(1.0, abs(place)), 1] for place in x]
        low, high = np.array([v.min() for v in at]), np.array([v.max() for v in at])
        found.append((str(collection.get_label()), x, low, high))
    return found


def legend(owner: Any) -> list[str]:
    """Texts of the legend of axes or a figure."""
    found = owner.get_legend() if hasattr(owner, "get_legend") else owner.legends[0]
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def check_legend(owner: Any, axes: Iterable[Any] = ()) -> None:
    """See that every text of a legend stands beside the look of the curve of that name."""
    found = owner.get_legend() if hasattr(owner, "get_legend") else owner.legends[0]
    assert found is not None
    drawn = {line.get_label(): line for one in (list(axes) or [owner]) for line in one.get_lines()}
    for handle, text in zip(found.legend_handles, found.get_texts(), strict=True):
        line = drawn.get(text.get_text())
        if line is not None and hasattr(handle, "get_linestyle") and hasattr(handle, "get_color"):
            assert to_hex(handle.get_color()) == to_hex(line.get_color()), text.get_text()
            assert handle.get_linestyle() == line.get_linestyle(), text.get_text()
            assert handle.get_marker() == line.get_marker(), text.get_text()


def same(found: tuple[Any, Any], x: Any, y: Any) -> None:
    """A curve against what should be drawn."""
    np.testing.assert_allclose(found[0], x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found[1], y, rtol=1e-9, atol=1e-12)


def check_curves(axes: Any, x: Any, expected: dict[str, Any]) -> None:
    """All named curves of axes, in any order, over one abscissa; that no other has a name, and that all is in sight."""
    found = curves(axes)
    assert set(found) == set(expected)
    for label, y in expected.items():
        same(found[label], x, y)
    check_in_sight(axes)


def check_in_sight(axes: Any) -> None:
    """See that no point of a curve lies outside the limits of its axes."""
    for values, limits in (("get_xdata", axes.get_xlim()), ("get_ydata", axes.get_ylim())):
        low, high = min(limits), max(limits)
        slack = 1e-9 * (high - low)
        for line in axes.get_lines():
            if line.get_transform() != axes.transData:
                continue  # a line across the whole axes
            data = np.asarray(getattr(line, values)(), dtype=float)
            data = data[np.isfinite(data)]
            assert not data.size or (low - slack <= data.min() and data.max() <= high + slack), line.get_label()


def heading(figure: Any) -> str:
    """Title of the whole picture."""
    return figure._suptitle.get_text()  # type: ignore[no-any-return]
