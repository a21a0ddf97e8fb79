"""`granfabric fit`: from curves that a user has measured to a material file."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.fit import report
from granfabric.cases.fit.deviations import StoppedError
from granfabric.cases.fit.reading import Curve, read_curve
from granfabric.cases.fit.settings import given
from granfabric.cases.fit.study import Compared, Fitted, compare, fit
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, versions
from granfabric.cases.scene.owner import Owner
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen

COMPILATION_SECONDS = 60
MOST_CURVES = 100


def curves_of(names: Sequence[str | Path]) -> list[Curve]:
    """Read the curves; two of the same name are told apart by a number.

    Raises
    ------
    InputError
    """
    if not names:
        raise InputError("no curve is named; give one CSV file or several")
    if len(names) > MOST_CURVES:
        raise InputError(f"{len(names)} curves are more than {MOST_CURVES}")
    return apart([read_curve(Path(name)) for name in names])


def apart(curves: Sequence[Curve]) -> list[Curve]:
    """The same curves with names that differ."""
    found: list[Curve] = []
    for curve in curves:
        taken, name, number = {other.name for other in found}, curve.name, 2
        while name in taken:
            name, number = f"{curve.name} ({number})", number + 1
        found.append(Curve(name, curve.lines, curve.columns, curve.errors, curve.notes, curve.place))
    return found


def _owner(kind: str, curves: Sequence[Curve]) -> Owner:
    names = ", ".join(curve.name for curve in curves)
    shown = names if len(names) < 150 else f"{names[:147]}..."
    shown = shown if shown.isprintable() else repr(shown)
    title = f"Fit to {shown}" if kind == "fit" else f"Law and data: {shown}"
    return Owner(kind, Path(curves[0].name).stem, title)


def run_fit(
    curves: Sequence[Curve],
    folder: Path,
    screen: Screen,
    free: Sequence[str] = (),
    material_file: str | None = None,
    assignments: Sequence[str] = (),
    overwrite: bool = False,
) -> tuple[Record, Fitted]:
    """Fit parameters of the law to curves and write material file, residuals, picture and record.

    Parameters
    ----------
    curves : sequence of Curve
    folder : Path
        New, empty, or of an earlier fit to curves of the same names.
    screen : Screen
    free : sequence of str
        Parameters; none for those that the curves tell.
    material_file : str, optional
        Where parameters begin or are held.
    assignments : sequence of str
        ``key=value``, see `fit.settings.Settings`.
    overwrite : bool
        Replace other results.

    Returns
    -------
    Record
        `outcome` is "finished", "stopped" (the best so far was written) or "failed" (not converged).
    Fitted

    Raises
    ------
    InputError
        If something given is not legal or cannot be identified; then nothing was written.
    RunError
        If the law follows the curves from no start, or it was stopped before that; nothing was written.
    """
    since, owner = time.perf_counter(), _owner("fit", curves)
    found = given(assignments, material_file)
    files.check_output(folder, owner, overwrite)
    with (
        interrupt_request(screen.announce_stop) as stop,
        watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
        screen.progress("fit", 1.0) as advance,
    ):
        try:
            fitted = fit(curves, found, free, advance, stop)
        except StoppedError as error:
            raise RunError("stopped before there was a fit; nothing was written") from error
    with files.held(folder, owner, overwrite):
        record = _recorded(fitted, owner, folder, screen, overwrite, "fit.csv", since)
        record.timing["compilation"] = watch.seconds
        record.outcome = "stopped" if fitted.stopped else "finished" if fitted.converged else "failed"
        record.message = fitted.message
        record.details["parameters"] = report.parameters(fitted)
        record.details["trials"] = fitted.steps
        record.details["remarks"] = fitted.remarks
        if fitted.uncertainty is not None:
            record.details["correlation"] = {
                "names": fitted.inner,
                "matrix": [[round(float(value), 6) for value in row] for row in fitted.uncertainty.correlation],
            }
        files.write_text(folder / files.MATERIAL, report.material_text(fitted))
        record.write()
        _draw(record, "fit.csv", owner.title)
        _say_fit(fitted, record, screen)
    return record, fitted


def run_comparison(
    curves: Sequence[Curve],
    folder: Path,
    screen: Screen,
    assignments: Sequence[str] = (),
    overwrite: bool = False,
) -> tuple[Record, Compared]:
    """Follow curves with a given law and write the differences: ``granfabric verify --data``.

    Parameters, errors and what is returned are as in `run_fit`; the outcome is "failed" where the law refused to follow
    a curve to its end.
    """
    since, owner = time.perf_counter(), _owner("data", curves)
    found = given(assignments)
    files.check_output(folder, owner, overwrite)
    with (
        interrupt_request(screen.announce_stop) as stop,
        watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
        screen.progress("law", 1.0) as advance,
    ):
        try:
            compared = compare(curves, found, advance, stop)
        except StoppedError as error:
            raise RunError("stopped before the law had followed the curves; nothing was written") from error
    with files.held(folder, owner, overwrite):
        record = _recorded(compared, owner, folder, screen, overwrite, "data.csv", since)
        record.timing["compilation"] = watch.seconds
        record.outcome = "failed" if compared.refusals else "finished"
        record.message = "; ".join(compared.refusals)
        record.details["parameters"] = compared.values
        record.write()
        _draw(record, "data.csv", owner.title)
        for curve in compared.curves:
            for note in curve.curve.notes:
                screen.note(note)
        _say_columns(compared, screen, "law against data: largest and root mean square error (law - data)")
        for line in compared.refusals:
            screen.say(line, insist=True)
        screen.say(f"results in {folder}")
    return record, compared


def _recorded(
    compared: Compared, owner: Owner, folder: Path, screen: Screen, overwrite: bool, table: str, since: float
) -> Record:
    """Make the folder ready and write the rows; the record that goes with them."""
    files.prepare_output(folder, owner, overwrite)
    base = compared.base
    scene = {
        "title": owner.title,
        "kind": owner.kind,
        "curves": [curve.curve.place for curve in compared.curves],
        "control": base.settings.control,
        "start": base.settings.start,
        "driven": {curve.curve.name: curve.driven for curve in compared.curves},
        "closure": base.closure,
        "effects": {name: getattr(base.effects, name) for name in base.effects.names()},
    }
    record = Record(folder, owner.name, scene, is_scene=False, since=since)
    record.details["columns"] = [vars(entry) for entry in _finite(report.column_errors(compared))]
    record.write()
    screen.keep_log(folder / files.LOG, versions())
    files.write_text(folder / table, files.csv_text(report.ROW_COLUMNS, report.rows(compared)))
    return record


def _finite(errors: list[report.ColumnError]) -> list[report.ColumnError]:
    """Those of columns of which something was reached; a record holds no NaN."""
    return [entry for entry in errors if entry.values]


def _draw(record: Record, table: str, title: str) -> None:
    from granfabric.cases.pictures.data import draw_data

    with record.phase("pictures"):
        draw_data(record.folder, table, title)
    record.write()


def _say_columns(compared: Compared, screen: Screen, title: str) -> None:
    rows = [
        [
            entry.quantity, entry.curve, str(entry.values), f"{entry.largest:+.4g}", str(entry.line),
            f"{entry.stress_ratio:.3f}", f"{entry.rms:.4g}", f"{entry.scale:.3g}",
        ]
        for entry in report.column_errors(compared)
    ]  # fmt: skip
    names = ["quantity", "curve", "values", "largest", "in line", "q/p there", "rms", "scale"]
    screen.table(title, names, rows, ["quantity", "curve"])


def _say_fit(fitted: Fitted, record: Record, screen: Screen) -> None:
    rows = []
    for entry in fitted.free:
        value, error = report.numbers(fitted.values[entry.name], fitted.errors[entry.name])
        rows.append([entry.name, value, error, f"{entry.first:.4g}", report.sources_text(fitted, entry.name)])
    names = ["parameter", "value", "standard error", "began at", "determined by"]
    screen.table(record.scene["title"], names, rows, ["parameter", "determined by"])
    _say_columns(fitted, screen, "what is left (law - data)")
    notes = {note for curve in fitted.curves for note in curve.curve.notes}
    for line in fitted.remarks:
        if line in notes:
            screen.note(line)
        else:
            screen.say(line)
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {fitted.message}; what is written is the best so far", insist=True)
    screen.say(f"{fitted.steps} trials in {record.timing['total']:.1f} s; results in {record.folder}")
