"""These tests need FEniCSx (extra `fenicsx`, Python 3.12 or later); without it each is skipped with the reason."""

from __future__ import annotations

import pytest

from granfabric.fem.fenicsx.engine import EngineError, dolfinx

HERE = __file__.rpartition("/")[0]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    try:
        dolfinx()
    except EngineError as error:
        for item in items:
            if str(item.path).startswith(HERE):
                item.add_marker(pytest.mark.skip(reason=str(error)))
