"""Places of a field scene whose values are written over the steps: `[[output.probe]]`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, create_model, model_validator

from .schema_base import Pair, Section

COUNT = 21
NAME, LONGEST_NAME = r"^[A-Za-z0-9_-]+$", 60
"""Of a probe, whose file has it."""

_ENDS: Any = {  # "from" is a word of Python
    "from": (Pair | None, Field(default=None, description="first place of a line: x, y [m]")),
}
_Line: Any = create_model("_Line", __base__=Section, **_ENDS)


class Probe(_Line):  # type: ignore[misc]
    """A place, or places along a line, whose values are written at every step to `probe_NAME.csv`."""

    name: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=NAME)] = Field(
        description="of the probe and its file: letters, digits, _ and -"
    )
    point: Pair | None = Field(default=None, description="a single place: x, y [m]")
    to: Pair | None = Field(default=None, description="last place of the line: x, y [m]")
    count: Annotated[int, Field(ge=2, le=100_000)] | None = Field(
        default=None, description=f"places of the line, equally spaced, both ends included; {COUNT} if not given"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Probe:
        start, end = getattr(self, "from"), self.to
        if (self.point is None) == (start is None and end is None):
            raise ValueError(f"probe {self.name!r} needs either point, or from and to")
        if self.point is None and (start is None or end is None):
            raise ValueError(f"probe {self.name!r} needs both ends of its line, from and to")
        if self.point is not None and self.count is not None:
            raise ValueError(f"probe {self.name!r} is a point; count goes with from and to")
        if start is not None and start == end:
            raise ValueError(f"probe {self.name!r}: the two ends of its line coincide")
        return self
