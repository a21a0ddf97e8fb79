"""`granfabric cost`: arithmetic of fronts, what each study must find, files, and that nothing finished is lost."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from granfabric.cases.commands import cost as command
from granfabric.cases.cost import distributions, output
from granfabric.cases.cost.batch import PATH_STRAIN, End, distance, make_batch
from granfabric.cases.cost.catalogue import STUDIES
from granfabric.cases.cost.footing import extrapolate
from granfabric.cases.cost.footing import order as footing_order
from granfabric.cases.cost.front import cheapest, mark_fronts, on_front, slope
from granfabric.cases.cost.integrators import observed_order
from granfabric.cases.cost.load_steps import QUANTITIES
from granfabric.cases.cost.load_steps import order as load_step_order
from granfabric.cases.cost.mesh import order as mesh_order
from granfabric.cases.cost.study import Effort, StudyError
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import RunError
from granfabric.cases.records import files
from granfabric.cases.terminal import clock
from granfabric.cases.terminal.clock import best_of
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify.model_side import BEST, closures


def silent_screen() -> tuple[Screen, io.StringIO]:
    text = io.StringIO()
    return Screen(Console(file=text, width=200)), text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All studies, quick."""
    place = tmp_path_factory.mktemp("cost")
    assert command.run_cost(None, place, silent_screen()[0], quick=True).outcome == "finished"
    return place


@pytest.fixture(scope="module")
def tables(folder: Path) -> dict[str, list[dict]]:
    record = json.loads((folder / "cost.json").read_text())
    return {name: entry["rows"] for name, entry in record["studies"].items()}


# fronts


def test_front_of_a_known_set() -> None:
    #             front  dominated  front  equal to the first  failed
    costs = [1.0, 2.0, 3.0, 1.0, 0.5]
    errors = [0.1, 0.1, 0.01, 0.1, math.nan]
    assert on_front(costs, errors).tolist() == [True, False, True, True, False]


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=30))
def test_front_is_what_nothing_dominates(points: list[tuple[int, int]]) -> None:
    front = on_front(*zip(*points))

    def dominates(a: tuple[int, int], b: tuple[int, int]) -> bool:
        return a[0] <= b[0] and a[1] <= b[1] and a != b

    for point, member in zip(points, front):
        above = [other for other, fine in zip(points, front) if fine and dominates(other, point)]
        assert bool(above) != bool(member)  # whoever is not on the front is dominated by someone who is


def test_fronts_are_marked_within_a_facet_for_time_and_count() -> None:
    rows = [
        {"facet": "a", "error": 1.0, "seconds": 1.0, "count": 9},
        {"facet": "a", "error": 2.0, "seconds": 2.0, "count": 1},
        {"facet": "b", "error": 3.0, "seconds": 3.0, "count": 9},
    ]
    mark_fronts(rows)
    assert [row["on_front"] for row in rows] == [1, 0, 1]
    assert [row["on_front_by_count"] for row in rows] == [1, 1, 1]


def test_slope_of_a_power_law_and_of_nothing() -> None:
    x = np.array([1.0, 2.0, 4.0, 8.0])
    assert slope(x, 3.0 * x**-2.5) == pytest.approx(-2.5, abs=1e-12)
    assert slope([*x, 16.0], [*(3.0 * x**-2.5), math.nan]) == pytest.approx(-2.5, abs=1e-12)
    assert math.isnan(slope([1.0], [1.0]))


def test_cheapest_that_is_accurate_enough() -> None:
    rows = [{"error": 0.1, "seconds": 1.0}, {"error": 0.01, "seconds": 3.0}, {"error": 0.001, "seconds": 2.0}]
    assert cheapest(rows, 0.05) is rows[2]
    assert cheapest(rows, 1.0) is rows[0]
    assert cheapest(rows, 1e-9) is None


@given(limit=st.floats(-5, 5), size=st.floats(0.1, 2.0), ratio=st.floats(0.05, 0.9))
def test_extrapolation_finds_the_limit_of_a_power(limit: float, size: float, ratio: float) -> None:
    values = [limit + size * ratio**level for level in range(4)]
    assert extrapolate(values) == pytest.approx(limit, abs=1e-9)


def test_extrapolation_refuses_what_diverges() -> None:
    with pytest.raises(StudyError, match="do not converge"):
        extrapolate([1.0, 2.0, 4.0])


def test_best_of_takes_the_least_time_a_call(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(clock.time, "process_time", lambda: now[0])
    durations = iter([0.5, 0.3, 0.4])

    def uneven() -> None:
        now[0] += next(durations)

    def long() -> None:
        now[0] += 2.0
        made.append("long")

    def short() -> None:
        now[0] += 1e-3

    made: list[str] = []
    ticks: list[int] = []
    assert best_of([uneven, long, short], 3, ticks.append) == pytest.approx([0.3, 2.0, 1e-3])
    assert made == ["long"]  # averages by itself
    assert ticks == list(range(1, 10))


# batches


def test_paths_have_the_stated_size_and_contain_unloading() -> None:
    batch = make_batch(64)
    size = np.sqrt(batch.strain[:, 0] ** 2 + batch.strain[:, 1] ** 2 + batch.strain[:, 2] ** 2 / 2)
    np.testing.assert_allclose(size, PATH_STRAIN, rtol=1e-12)
    assert batch.biaxial.sum() == 16
    along = (batch.stress[:, 0] - batch.stress[:, 1]) * (batch.strain[:, 0] - batch.strain[:, 1])
    along += 2 * batch.stress[:, 2] * batch.strain[:, 2]
    assert (along[~batch.biaxial] > 0).any() and (along[~batch.biaxial] < 0).any()


def test_distance_is_the_largest_of_its_parts() -> None:
    stress = np.array([[-2.0, -2.0, 0.0]])
    here = End(stress, np.array([4.0]), np.array([[0.1, 0.0]]), 1, 0, 0)
    assert distance(here, here) == 0.0
    assert distance(End(stress + 0.2, here.coordination, here.fabric, 1, 0, 0), here) == pytest.approx(0.1)
    assert distance(End(stress, here.coordination * 1.3, here.fabric, 1, 0, 0), here) == pytest.approx(0.3)
    assert distance(End(stress, here.coordination, here.fabric + [[0, 0.5]], 1, 0, 0), here) == pytest.approx(0.5)


# what the studies must find


def test_integrators_converge_with_their_orders(tables: dict) -> None:
    rows = tables["integrators"]
    orders = {"forward_euler": 1, "modified_euler": 2, "bogacki_shampine": 3, "kennedy_carpenter": 3}
    margins = {"forward_euler": 0.1, "modified_euler": 0.15, "bogacki_shampine": 0.3, "kennedy_carpenter": 0.3}
    for name, order in orders.items():
        margin = margins[name]
        assert observed_order(rows, name, "mean field, 1e-4") == pytest.approx(order, abs=margin), name
    for name in ("modified_euler", "bogacki_shampine", "dormand_prince", "kennedy_carpenter"):
        controlled = [row for row in rows if row["integrator"] == name]
        # a local tolerance bounds the global error up to the growth along the path, here of order one
        assert all(row["error"] < 10 * row["tolerance"] for row in controlled), name
        assert controlled[-1]["error"] < 1e-8
        # the last stage of a substep is the next one's first: one more for each increment
        stages = {"modified_euler": 2, "bogacki_shampine": 3, "dormand_prince": 6, "kennedy_carpenter": 3}[name]
        for row in controlled:
            increments = {"1e-4": 1, "1e-6": 100}[row["facet"].split(", ")[-1]]
            stages_taken = increments + stages * (row["substeps"] + row["rejected"])
            if name == "kennedy_carpenter":  # some passes for each of its three implicit stages
                assert 1.5 * stages_taken < row["count"] < 8 * stages_taken
            else:
                assert row["count"] == pytest.approx(stages_taken, rel=1e-12)


def test_closed_form_is_exact_and_quadrature_converges(tables: dict) -> None:
    rows = tables["arcs"]
    closed = [row for row in rows if row["directions"] == 0]
    assert len(closed) == 1 and closed[0]["error"] <= 1e-12
    for facet in ("harmonic", "maximum_entropy", "shifted_distribution"):
        errors = [row["error"] for row in rows if row["facet"] == facet and row["directions"]]
        assert errors == sorted(errors, reverse=True)
        assert errors[0] > 1e3 * errors[-1] and errors[-1] < 1e-12  # faster than any power


def test_exact_tangent_needs_fewest_iterations_and_kept_factors_save_factorisations(tables: dict) -> None:
    rows = {(row["tangent_kind"], row["keep_factor"]): row for row in tables["tangents"]}
    iterations = [rows[kind, 0]["newton_iterations"] for kind in ("propagated", "continuum", "elastic")]
    assert iterations == sorted(iterations) and iterations[0] < iterations[-1]
    for kind in ("propagated", "continuum", "elastic"):
        assert rows[kind, 0]["factorisations"] == rows[kind, 0]["newton_iterations"]
        assert rows[kind, 1]["factorisations"] < rows[kind, 0]["factorisations"]
    # Newton's tolerance is 1e-8 of the forces; strains of 1e-4 at kn/p = 1e4 keep it in the means
    assert 1e-14 < max(row["error"] for row in rows.values()) < 1e-7


@pytest.mark.parametrize("element", ["P1", "Q1", "P2", "Q2"])
def test_elements_converge_with_order_p_plus_one(tables: dict, element: str) -> None:
    assert mesh_order(tables["mesh"], element) == pytest.approx(int(element[1]) + 1, abs=0.15)


def test_load_steps_converge_with_order_two(tables: dict) -> None:
    # strain goes straight within a step: the path is followed by its chords
    for quantity in QUANTITIES:
        assert load_step_order(tables["load_steps"], quantity) == pytest.approx(2.0, abs=0.2)


def test_files_hold_the_same_however_compressed_and_fewer_steps_lose_between_them(tables: dict) -> None:
    rows = tables["output"]
    by_kind = {kind: [row for row in rows if row["series"] == kind] for kind in output.KINDS}
    errors = {tuple(row["error"] for row in members) for members in by_kind.values()}
    assert len(errors) == 1  # compression loses nothing
    (between,) = errors
    assert list(between) == sorted(between)
    # linear between the steps: order two, down to what the load steps themselves leave
    assert slope(output.QUICK_EVERY[1:], between[1:]) == pytest.approx(1.8, abs=0.4)
    for plain, fast, small in zip(*by_kind.values(), strict=True):
        assert plain["count"] > fast["count"] > small["count"]
    sizes = [row["bytes_a_step"] for row in by_kind["none"]]
    assert sizes == pytest.approx([sizes[0]] * len(sizes), rel=1e-3)
    assert [row["steps_written"] for row in by_kind["none"]] == [10, 6, 4, 3]
    told = output.findings(rows)
    assert len(told) == 6 and "times the processor time of the run without" in told[0] and "'small'" in told[2]


def test_error_between_what_is_written() -> None:
    """A parabola between its ends, and what is linear."""
    wanted = np.linspace(0.0, 1.0, 5)
    reference = np.stack([1.0 + wanted**2, 2.0 + 3.0 * wanted], axis=1)
    for times, error in (([0.0, 1.0], 0.25 / 1.25), ([0.0, 0.5, 1.0], 0.0625 / 1.0625), (wanted, 0.0)):
        values = np.stack([1.0 + np.square(times), 2.0 + 3.0 * np.array(times)], axis=1)
        assert output.error_between(np.array(times), values, wanted, reference) == pytest.approx(error, abs=1e-15)


@pytest.mark.parametrize("magnitude", distributions.MAGNITUDES)
def test_distributions_start_from_every_fabric_of_the_study(magnitude: float) -> None:
    """Also beyond the harmonic limit, with forces that carry the stress: s = (a_c + a_n + a_t)/2."""
    batch = distributions.batch_at(5, magnitude)
    law = distributions.law_of(distributions._integration(0))
    state = distributions.start_of(law, batch)
    names = ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy")
    fabric, normal, tangential = (state[:, law.description.columns(name)] for name in names)
    assert fabric == pytest.approx(batch.fabric, abs=1e-15)
    s = np.stack([batch.stress[:, 0] - batch.stress[:, 1], 2 * batch.stress[:, 2]], axis=1)
    s = s / (batch.stress[:, 0] + batch.stress[:, 1])[:, None]
    assert fabric + normal + tangential == pytest.approx(2 * s, abs=1e-14)
    assert distributions.follow(law, batch, state, 1).failed == 0


def test_distributions_meet_in_isotropy_and_part_with_anisotropy(tables: dict) -> None:
    rows = tables["distributions"]
    small, large = ([row for row in rows if row["fabric"] == fabric] for fabric in (0.3, 0.9))
    assert small[0]["difference"] < 0.3 * large[0]["difference"]
    for members in (small, large):
        entropy = [row["error"] for row in members if row["distribution"] == "maximum_entropy"]
        assert entropy == sorted(entropy, reverse=True) and entropy[-1] < 1e-9  # faster than any power
        assert next(row for row in members if row["directions"] == 0)["error"] <= 1e-12


def test_footing_is_limited_by_its_edge(tables: dict) -> None:
    rows = tables["footing"]
    # values of another code at n = 35 and 80, twenty steps: between what is found here and its limit
    limit = rows[0]["mean_pressure"] / (1.0 + rows[0]["error"])
    assert 5.9 < limit < 6.117
    for element in ("P1", "Q1", "P2", "Q2"):
        values = [row["mean_pressure"] for row in rows if row["series"] == element]
        assert values == sorted(values, reverse=True)  # displacements that are prescribed: too stiff, from above
        assert footing_order(rows, element) == pytest.approx(1.0, abs=0.3)
    finest = {row["series"]: row for row in rows}
    assert finest["P1"]["error"] > 3 * finest["P2"]["error"]  # locking


def test_grains_of_more_disks_scatter_less_and_slow_loading_converges(tables: dict) -> None:
    rows = tables["dem"]
    single = [row for row in rows if row["facet"] == "disks" and row["packings"] == 1]
    assert single[0]["error"] > single[-1]["error"] and single[0]["error"] < 0.2
    rates = [row for row in rows if row["facet"] == "rate"]
    assert rates[0]["error"] > rates[-1]["error"]
    counts = [row["count"] for row in rates]
    assert counts == sorted(counts)  # slower takes more steps
    for row in rates:
        # the servo approaches its limit from below and corrects what oversteps
        assert row["largest_inertial_number"] < 1.2 * row["inertial_number"]


def test_state_form_follows_a_loop_of_grains_and_the_source_does_not(tables: dict) -> None:
    loop = {row["series"]: row for row in tables["closures"] if row["facet"] == "loop"}
    assert set(loop) == set(closures({"coordination": 4.0, "solid_fraction": 0.85, "normal_stiffness": 1e9}))
    assert loop[BEST]["error"] < 0.3 * loop["mean_field"]["error"]
    assert loop["mean_field"]["error_coordination"] > 0.1  # it ratchets
    # a closure in the form of rates may ratchet to a stiffness that is not positive definite, and be refused
    followed = [closure for closure in loop if not loop[closure]["failed_packings"]]
    assert {"mean_field", BEST} <= set(followed)
    for closure in followed:
        values = [row["error"] for row in tables["closures"] if row["series"] == closure and row["facet"] == "loop"]
        assert max(values) < 1.05 * min(values)  # the tolerance does not matter beside the model


@pytest.mark.parametrize("name", ["mesh", "arcs"])
def test_counts_and_errors_repeat(tables: dict, name: str) -> None:
    with clock.one_thread():
        again = STUDIES[name].rows(Effort(quick=True, rounds=1))
    for first, second in zip(tables[name], again, strict=True):
        assert first["count"] == second["count"]
        assert first["error"] == pytest.approx(second["error"], rel=1e-6)


def test_grains_at_points(tables: dict[str, list[dict]]) -> None:
    rows = tables["grains"]
    step = {row["setting"]: row["error"] for row in rows if row["series"] == "strain step"}
    assert step[5e-9] < 0.5 * step[1e-7] < 0.25 * step[1e-5]
    work = {row["series"]: row for row in rows if row["facet"] == "tangents"}
    assert all(row["error"] < 1e-3 and row["cuts"] == 0 for row in work.values())
    drives = {name: row["count"] / row["law_calls"] for name, row in work.items()}
    # four drives a call; those without an increment cost nothing but in the perturbed one
    assert drives["perturbed, symmetrised"] > 2.5 * drives["secant"]
    assert work["secant"]["newton_iterations"] <= work["isotropic elastic"]["newton_iterations"]


# files


def test_every_study_leaves_table_picture_and_section(folder: Path, is_drawn: Callable[[Path], bool]) -> None:
    page = (folder / "cost.md").read_text()
    record = json.loads((folder / "cost.json").read_text())
    assert list(record["studies"]) == list(STUDIES)
    for name, study in STUDIES.items():
        assert list(files.read_csv(folder / f"{name}.csv")) == [column.name for column in study.columns]
        assert is_drawn(folder / f"{name}.png")
        assert f"![{study.title}]({name}.png)" in page and study.question in page
        entry = record["studies"][name]
        assert entry["findings"] and all(text in page for text in entry["findings"])
        assert set(entry["columns"]) == {column.name for column in study.columns}
        for row in entry["rows"]:
            assert row["seconds"] > 0 and row["count"] > 0
        # the table holds what the record holds, column by column
        for column, values in files.read_csv(folder / f"{name}.csv").items():
            assert values == ["" if row[column] is None else row[column] for row in entry["rows"]], (name, column)
    assert not list(folder.glob(".granfabric-*"))


def test_one_study_is_computed_anew_and_the_others_stay(folder: Path) -> None:
    before = {name: (folder / f"{name}.csv").read_bytes() for name in STUDIES}
    screen, text = silent_screen()
    done = command.run_cost("mesh", folder, screen, quick=True)
    assert done.studies == ("mesh",)
    assert f"kept from earlier: {', '.join(name for name in STUDIES if name != 'mesh')}" in text.getvalue()
    for name in STUDIES:
        if name != "mesh":
            assert (folder / f"{name}.csv").read_bytes() == before[name]
    assert list(json.loads((folder / "cost.json").read_text())["studies"]) == list(STUDIES)


def test_studies_side_by_side_find_the_same(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for their times, which they disturb."""
    names = ("arcs", "distributions")
    monkeypatch.setattr(command, "chosen", lambda name: [STUDIES[name] for name in names])
    screen, text = silent_screen()
    done = command.run_cost(None, tmp_path / "both", screen, quick=True, choice=Choice(workers=2))
    assert done.outcome == "finished" and set(done.studies) == set(names) and "2 processes" in text.getvalue()
    for name in names:
        before, after = (files.read_csv(place / f"{name}.csv") for place in (folder, tmp_path / "both"))
        for column in ("facet", "series", "setting", "error", "count"):
            assert before[column] == after[column], (name, column)


@pytest.mark.parametrize("error", [KeyboardInterrupt, StudyError])
def test_finished_studies_survive_the_end_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    def broken(effort: Effort) -> list:
        raise error("the reference is missing")

    mesh = STUDIES["mesh"]
    arcs = STUDIES["arcs"]
    studies = [mesh, type(mesh)(**{**mesh.__dict__, "name": "tangents", "rows": broken}), arcs]
    monkeypatch.setattr(command, "chosen", lambda name: studies)
    screen, text = silent_screen()
    if error is StudyError:
        with pytest.raises(RunError, match="tangents: the reference is missing; finished: mesh, arcs"):
            command.run_cost(None, tmp_path / "new", screen, quick=True)
    else:
        done = command.run_cost(None, tmp_path / "new", screen, quick=True)
        assert done.outcome == "stopped" and done.studies == ("mesh",)
        assert "finished: mesh; not computed: tangents, arcs" in text.getvalue()
    finished = ("mesh", "arcs") if error is StudyError else ("mesh",)
    names = {file.name for file in (tmp_path / "new").iterdir()}
    made = (f"{name}.{kind}" for name in finished for kind in ("csv", "png"))
    assert names == {"cost.json", "cost.md", "run.log", *made}
    monkeypatch.setattr(command, "chosen", lambda name: [mesh, arcs])
    before = (tmp_path / "new" / "mesh.csv").read_bytes()
    again = command.run_cost(None, tmp_path / "new", screen, quick=True, resume=True)
    assert again.studies == (() if error is StudyError else ("arcs",))
    assert (tmp_path / "new" / "mesh.csv").read_bytes() == before


def test_unknown_study_and_foreign_folder_are_refused(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("cost", "integrater", "-o", tmp_path / "new")
    assert result.code == 2 and "nearest is 'integrators'" in result.err and not (tmp_path / "new").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    result = granfabric("cost", "mesh", "--quick", "-o", tmp_path / "mine")
    assert result.code == 2 and "not a result" in result.err
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text('{"program": "granfabric"}')
    result = granfabric("cost", "mesh", "--quick", "-o", tmp_path / "run")
    assert result.code == 2 and "another command" in result.err
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run.json"]
