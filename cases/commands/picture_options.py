"""`--format` of every command that draws, and how commands end."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, get_type_hints

import typer

from granfabric.cases.pictures import formats

FormatOption = Annotated[
    str | None,
    typer.Option("--format", metavar="png,pdf,svg", help="Formats of pictures, with commas between; PNG if not given."),
]


PictureFormatOption = Annotated[
    str | None,
    typer.Option(
        "--picture-format", metavar="png,pdf,svg", help="Formats of pictures, with commas between; PNG if not given."
    ),
]
"""Where `--format` means that of another file."""

DRAWING = {"run", "point", "dem", "verify", "cost", "convergence", "measure", "fit", "mesh", "plot", "sweep"}


def add_to(app: typer.Typer) -> None:
    """Give the commands of an application that draw the option."""
    for command in app.registered_commands:
        callback = command.callback
        if callback is not None and (command.name or callback.__name__) in DRAWING:
            command.callback = _with_formats(callback)


def _with_formats(command: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(command)
    def drawing(*arguments: Any, formats_given: str | None, **options: Any) -> Any:
        chosen = formats.DEFAULT if formats_given is None else formats.parsed(formats_given)
        with formats.written_as(chosen):
            return command(*arguments, **options)

    hints = get_type_hints(command, include_extras=True)
    given = inspect.signature(command)
    own = [parameter.replace(annotation=hints[name]) for name, parameter in given.parameters.items()]
    annotation = PictureFormatOption if _has_format(hints) else FormatOption
    option = inspect.Parameter("formats_given", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
    drawing.__signature__ = given.replace(parameters=[*own, option])  # type: ignore[attr-defined]
    drawing.__annotations__ = {**hints, "formats_given": annotation}
    del drawing.__wrapped__  # type: ignore[attr-defined]  # its signature is another
    return drawing


def _has_format(hints: dict[str, Any]) -> bool:
    """Whether a command has a `--format` of its own."""
    return any(
        # in an annotation the first name stands where the default would
        "--format" in (getattr(part, "default", None), *(getattr(part, "param_decls", None) or ()))
        for hint in hints.values()
        for part in getattr(hint, "__metadata__", ())
    )


def exit_by(outcome: str) -> None:
    """End with code 1 unless the run came to its end."""
    if outcome != "finished":
        raise typer.Exit(1)
