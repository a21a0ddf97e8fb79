"""Colours and dashes of the closures in figures."""

from __future__ import annotations

from typing import Any

from .style import BLUE, GREEN, ORANGE, PURPLE, RED, SKY

LINES: tuple[tuple[str, Any], ...] = (
    (RED, "--"), (ORANGE, (0, (6, 1.5, 1.5, 1.5))), (GREEN, (0, (2, 1))), (PURPLE, "-."), (BLUE, "-"), (SKY, ":")
)  # fmt: skip


def line_of(place: int) -> tuple[str, Any]:
    """Colour and dashes of the closure at this place."""
    return LINES[place % len(LINES)]
