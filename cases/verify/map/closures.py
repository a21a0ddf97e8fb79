"""Closures of the map."""

from __future__ import annotations

from granfabric.cases.verify.model_side import BEST, SOURCE, closures

from .tasks import SOME_INPUTS

CLOSURES = tuple(closures(SOME_INPUTS))
"""All that are compared; their places give them their colours."""
QUICK_CLOSURES = (SOURCE, BEST)
