"""`--format` of every command that draws: which files come, what is refused, what an earlier format leaves behind."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from granfabric.cases.commands import picture_options
from granfabric.cases.commands.cli import app
from granfabric.cases.errors import InputError
from granfabric.cases.pictures import formats

BEGINNING = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
POINT = ("point", "p_constant", "--set", "path.0.increments=2")
DRAWN = ("stress_strain", "fabric_decomposition", "microvariables")


def of(*kinds: str) -> set[str]:
    """Pictures of a point in some formats."""
    return {f"{name}.{kind}" for name in DRAWN for kind in kinds}


def pictures(folder: Path) -> set[str]:
    """Files that begin as the kinds of pictures do, and have their endings."""
    found = {file for file in folder.iterdir() if file.suffix[1:] in BEGINNING}
    for file in found:
        assert file.read_bytes().startswith(BEGINNING[file.suffix[1:]]), file
    return {file.name for file in found}


def test_commands_that_draw_have_the_option_and_no_others() -> None:
    own = {"measure": "--picture-format"}  # whose --format is that of a packing
    assert set(typer.main.get_command(app).commands) >= picture_options.DRAWING
    for name, command in typer.main.get_command(app).commands.items():
        options = {word for parameter in command.params for word in parameter.opts}
        draws = name in picture_options.DRAWING
        assert (own.get(name, "--format") in options) == draws, name


@pytest.mark.parametrize(("asked", "kinds"), [("pdf", ["pdf"]), ("SVG, png,svg", ["svg", "png"])])
def test_a_run_its_plot_and_what_was_there_before(
    granfabric: Callable, tmp_path: Path, asked: str, kinds: list[str]
) -> None:
    out = tmp_path / "out"
    assert granfabric(*POINT, "-o", out).code == 0
    assert pictures(out) == of("png")
    done = granfabric(*POINT, "-o", out, "--format", asked)
    assert done.code == 0, done.err
    assert pictures(out) == of(*kinds)
    assert granfabric("plot", out, "--format", "pdf").code == 0
    assert pictures(out) == of(*kinds, "pdf")
    assert granfabric(*POINT, "-o", out).code == 0
    assert pictures(out) == of("png")
    # nothing of it stays: the next run of this process draws as ever
    assert formats.chosen() == formats.DEFAULT


def test_the_same_bytes_again(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric(*POINT, "-o", tmp_path / "a", "--format", "pdf,png,svg").code == 0
    first = {name: (tmp_path / "a" / name).read_bytes() for name in pictures(tmp_path / "a")}
    assert granfabric("plot", tmp_path / "a", "--format", "pdf,png,svg").code == 0
    assert set(first) == of("pdf", "svg", "png")
    for name in of("pdf", "png"):
        assert (tmp_path / "a" / name).read_bytes() == first[name]


@pytest.mark.parametrize("command", [POINT, ("run", "biaxial"), ("dem", "dem_biaxial"),
                                     ("sweep", "p_constant", "--set", "material.coordination=3.9,4")])  # fmt: skip
def test_an_unknown_format_is_refused_before_anything(granfabric: Callable, tmp_path: Path, command: tuple) -> None:
    result = granfabric(*command, "-o", tmp_path / "out", "--format", "png,jpg")
    assert result.code == 2 and not (tmp_path / "out").exists()
    assert re.search(r"--format png,jpg: the format 'jpg' is unknown \(legal: png, pdf, svg\)", result.err)


def test_of_a_mesh(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("mesh", "biaxial", "-o", tmp_path / "mesh.png", "--format", "svg").code == 0
    assert pictures(tmp_path) == {"mesh.svg"}


@pytest.mark.slow
def test_of_a_sweep_and_its_runs(granfabric: Callable, tmp_path: Path) -> None:
    """Also of those that other processes compute."""
    sweep = ("sweep", "p_constant", "--set", "path.0.increments=2,3", "-o", tmp_path / "out", "--workers", 2)
    assert granfabric(*sweep, "--pictures", "--format", "svg").code == 0
    assert pictures(tmp_path / "out") == {"results.svg"}
    assert pictures(tmp_path / "out" / "increments=2") == of("svg")
    assert granfabric(*sweep, "--overwrite").code == 0
    assert pictures(tmp_path / "out") == {"results.png"} and pictures(tmp_path / "out" / "increments=2") == set()


def test_names_of_formats() -> None:
    assert formats.parsed("PDF, png,pdf") == ("pdf", "png")
    for text in ("", "png,", "eps"):
        with pytest.raises(InputError, match="--format"):
            formats.parsed(text)
