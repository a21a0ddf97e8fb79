"""From measured curves to the law: fitted parameters with standard errors, and a law compared with curves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.commands.fit import apart, run_comparison, run_fit
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.fit import report, study
from granfabric.cases.fit.deviations import StoppedError
from granfabric.cases.fit.reading import Curve, curve_of, read_curve
from granfabric.cases.fit.settings import given
from granfabric.cases.scene.toml_text import value_text
from granfabric.constitutive.parameters import Closure, Material

from .scenes import _Silent

if TYPE_CHECKING:
    import pandas

__all__ = ["FitResult", "compare_with_data", "fit"]

Columns = Mapping[str, Any]
Data = str | Path | Columns | Sequence[str | Path | Columns]


@dataclass(frozen=True)
class FitResult:
    """Parameters of the law fitted to curves.

    Parameters
    ----------
    outcome : str
        "finished", "stopped" (the best so far), or "failed" (not converged: the best found).
    message : str
        Why not finished, if so.
    values, errors : dict of str to float
        Of the free parameters by the names of scene keys, and their standard errors (NaN of one on a bound).
    held : dict of str to float
        All other parameters.
    correlation : ndarray, shape (n, n)
        Of the free parameters that are not on a bound, in the order of `correlated`.
    correlated : tuple of str
    sources : dict of str to dict
        For each free parameter the part of what determines it by column, largest first.
    remarks : list of str
        What is doubtful, a sentence each.
    residuals : pandas.DataFrame
        A row for each value of a curve: data, law, residual = law - data, scale, deviation = residual over scale.
    material : Material
    closure : Closure
    text : str
        Text of a material file.
    """

    outcome: str
    message: str
    values: dict[str, float]
    errors: dict[str, float]
    held: dict[str, float]
    correlation: NDArray[np.float64]
    correlated: tuple[str, ...]
    sources: dict[str, dict[str, float]]
    remarks: list[str]
    residuals: pandas.DataFrame = field(repr=False)
    material: Material = field(repr=False)
    closure: Closure = field(repr=False)
    text: str = field(repr=False)


def fit(
    data: Data,
    free: str | Sequence[str] = (),
    material_file: str | Path | None = None,
    changes: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    progress: Callable[[float, str], None] | None = None,
    stop: Callable[[], bool] | None = None,
    overwrite: bool = False,
) -> FitResult:
    """Fit parameters of the law to measured curves, as `granfabric fit` does.

    Parameters
    ----------
    data : str, Path, mapping of str to array, or a sequence of these
        CSV files, or columns such as a DataFrame or `PathHistory.columns`. Names of columns and signs as in a file:
        stresses and strains tension positive, p and q compression positive, SI units.
    free : str or sequence of str
        Parameters; those that the curves tell if none is named.
    material_file : str or Path, optional
        Where the fit begins, and what is held.
    changes : mapping of str to value, optional
        Keys as `--set` takes them: ``{"material.solid_fraction": 0.84}``; what is given here is held.
    output : str or Path, optional
        Folder for the files that the command writes; nothing is written if not given.
    progress : callable, optional
        ``progress(fraction, text)``.
    stop : callable, optional
        Asked between trials; True ends the search with the best so far. Not with `output`.
    overwrite : bool
        Replace other results in `output`.

    Returns
    -------
    FitResult

    Raises
    ------
    InputError
        If something given is not legal, or a parameter that was named cannot be identified from these curves.
    RunError
        If the law follows the curves from no start, or it was stopped before that.

    Examples
    --------
    >>> import granfabric as gf
    >>> law = gf.ContactLaw([gf.Material(coordination=4.0, solid_fraction=0.84, normal_stiffness=1e9,
    ...                                  force_density_at_zero=0.65)])
    >>> measured = gf.drive(law, (-1e5, -1e5, 0.0), [gf.Leg(target=(-8e4, -12e4, 0.0), increments=10)]).columns
    >>> curve = {name: measured[name] for name in ("p", "q", "coordination", "fabric_anisotropy")}
    >>> known = {"material.solid_fraction": 0.84, "material.normal_stiffness": 1e9}
    >>> known |= {"closure.force_change": "mean_field"}
    >>> found = gf.fit(curve, free="coordination,force_density_at_zero", changes=known)
    >>> found.outcome, round(found.values["force_density_at_zero"], 4), found.errors["force_density_at_zero"] < 1e-4
    ('finished', 0.65, True)
    """
    names = [free] if isinstance(free, str) and free else list(free)
    curves = _curves(data)
    assignments = _assignments(changes)
    file = None if material_file is None else str(material_file)
    if output is not None:
        if stop is not None:
            raise InputError("fit: stop goes without output; with it Ctrl-C ends the search")
        record, fitted = run_fit(curves, Path(output), _Silent(progress), names, file, assignments, overwrite)
        return _result(fitted, record.outcome)
    try:
        fitted = study.fit(
            curves, given(assignments, file), names, progress or (lambda fraction, text: None), stop or (lambda: False)
        )
    except StoppedError as error:
        raise RunError("stopped before there was a fit") from error
    return _result(fitted, "stopped" if fitted.stopped else "finished" if fitted.converged else "failed")


def compare_with_data(
    data: Data, changes: Mapping[str, Any] | None = None, output: str | Path | None = None, overwrite: bool = False
) -> pandas.DataFrame:
    """Compare the law with measured curves without fitting, as `granfabric verify --data` does.

    Parameters
    ----------
    data, output, overwrite :
        As in `fit`.
    changes : mapping of str to value, optional
        Keys as `--set` takes them, for instance ``{"material_file": "dense_disks"}``.

    Returns
    -------
    pandas.DataFrame
        As `FitResult.residuals`; NaN where the law did not follow.

    Raises
    ------
    InputError

    Examples
    --------
    >>> import granfabric as gf
    >>> curve = {"p": [1e5, 1e5], "q/p": [0.0, 0.2], "z": [3.896, 3.70]}
    >>> table = gf.compare_with_data(curve, {"material_file": "dense_disks"})
    >>> bool(abs(table["residual"].iloc[-1]) < 0.05)
    True
    """
    import pandas

    curves = _curves(data)
    if output is not None:
        _, compared = run_comparison(curves, Path(output), _Silent(None), _assignments(changes), overwrite)
    else:
        compared = study.compare(curves, given(_assignments(changes)), lambda fraction, text: None, lambda: False)
    return pandas.DataFrame(report.rows(compared), columns=list(report.ROW_COLUMNS))


def _assignments(changes: Mapping[str, Any] | None) -> list[str]:
    return [
        f"{key}={value_text(str(value) if isinstance(value, Path) else value)}"
        for key, value in (changes or {}).items()
    ]


def _curves(data: Data) -> list[Curve]:
    every: list[Any] = [data] if isinstance(data, str | Path) or hasattr(data, "keys") else list(data)
    if not every:
        raise InputError("no curve is given")
    many = len(every) > 1
    return apart(
        [
            read_curve(Path(one)) if isinstance(one, str | Path) else curve_of(one, f"curve {n}" if many else "curve")
            for n, one in enumerate(every, start=1)
        ]
    )


def _result(fitted: study.Fitted, outcome: str) -> FitResult:
    import pandas

    assert fitted.uncertainty is not None
    names = [entry.name for entry in fitted.free]
    return FitResult(
        outcome,
        fitted.message,
        {name: fitted.values[name] for name in names},
        dict(fitted.errors),
        {name: value for name, value in fitted.values.items() if name not in names},
        fitted.uncertainty.correlation,
        tuple(fitted.inner),
        {name: report.sources(fitted, name) for name in names},
        list(fitted.remarks),
        pandas.DataFrame(report.rows(fitted), columns=list(report.ROW_COLUMNS)),
        fitted.base.material_of(fitted.values),
        fitted.base.closure_of(fitted.values),
        report.material_text(fitted),
    )

