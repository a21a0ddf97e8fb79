"""`granfabric run SCENE --host fenicsx -o DIR` that asks to stop after some steps: arguments SCENE, DIR, steps."""

from __future__ import annotations

import sys
from pathlib import Path

from granfabric.cases.commands.run import run_field
from granfabric.cases.records.field_recorder import FieldRecorder
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.interruption import InterruptRequest
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.fenicsx.team import Team


def main() -> None:
    scene, folder, steps = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    team = Team()
    if not team.leads:
        team.assist()
        return
    received = FieldRecorder.__call__
    counted: list[int] = []

    def call(self: FieldRecorder, step: object) -> None:
        counted.append(1)
        received(self, step)  # type: ignore[arg-type]

    FieldRecorder.__call__ = call  # type: ignore[method-assign]
    InterruptRequest.__call__ = lambda self: len(counted) >= steps  # type: ignore[method-assign]
    with team:
        record = run_field(load(scene, []), folder, Screen(quiet=True), team=team)
    sys.exit(record.outcome != "finished")


if __name__ == "__main__":
    main()
