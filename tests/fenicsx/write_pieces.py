"""`write_pieces.py FOLDER NAME:LAW ...`: the series of problems in pieces, by each rank, and in one, by rank 0.

For each problem the folders `NAME_LAW/pieces` and `NAME_LAW/whole`. At last a rank cannot write, which all are told.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from problems import LAWS, PROBLEMS

from granfabric.fem.equilibrium.initial import initial_result
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.fenicsx.pieces import PieceOutput
from granfabric.fem.fenicsx.team import Team
from granfabric.fem.output.fields import FieldWriter
from granfabric.fem.output.series_files import OutputError, SeriesFiles


def main() -> None:
    team = Team()
    if not team.leads:
        team.assist()
        return
    folder = Path(sys.argv[1])
    control = StepControl(tolerance=1e-11)
    with team:
        for name in sys.argv[2:]:
            kind, _, law = name.partition(":")
            problem = PROBLEMS[kind](LAWS[law])
            steps: list[Any] = []
            series = SeriesFiles(folder / f"{kind}_{law}" / "pieces")
            summary = team.solve(problem, control, steps.append, pieces=PieceOutput(series, every=2))
            assert summary.finished, summary.message
            writer = FieldWriter(
                folder / f"{kind}_{law}" / "whole", problem.space, problem.law.description, None, problem.material_index
            )
            stages = [stage.name for stage in problem.stages]
            for step in [initial_result(problem), *steps]:
                if step.step % 2 == 0 or step is steps[-1]:
                    writer.write(step, stages.index(step.stage) + step.fraction)
        blocked = folder / "blocked"
        (blocked / f"points_0001_{team.comm.size - 1}.vtu").mkdir(parents=True)
        problem = PROBLEMS["fill"](LAWS["elastic"])
        try:
            team.solve(problem, control, pieces=PieceOutput(SeriesFiles(blocked)), on_step=lambda step: None)
        except OutputError as error:
            print(f"told: {error}")
        assert team.solve(problem, control).finished


if __name__ == "__main__":
    main()
