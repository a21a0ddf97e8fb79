"""The shipped scenes as a gallery: pictures, questions, and the text of each scene."""

from __future__ import annotations

from pathlib import Path

from .markdown import page
from .project import shipped

DOCS = Path(__file__).resolve().parents[2]
FIGURES = DOCS / "figures"

COMMANDS = {
    "point": "granfabric point", "field": "granfabric run", "dem": "granfabric dem", "specimen": "granfabric dem"
}  # fmt: skip
HEADINGS = {"point": "Points", "field": "Boundary-value problems", "dem": "DEM", "specimen": "DEM with boundaries"}
ORDER = ("field", "point", "dem", "specimen")


def pictures(name: str) -> list[Path]:
    """Pictures of a scene, the overview first."""
    overview = FIGURES / f"scene_{name}.png"
    return ([overview] if overview.is_file() else []) + sorted(FIGURES.glob(f"scene_{name}_closed_form.png"))


def _card(entry) -> str:
    found = pictures(entry.name)
    image = f":img-top: ../../figures/{found[0].name}\n:img-alt: {entry.title}\n" if found else ""
    return (
        f":::{{grid-item-card}} {entry.title}\n{image}:link: {entry.name}\n:link-type: doc\n\n`{entry.name}`\n:::"
    )


def _scene(entry) -> str:
    images = [f"```{{image}} ../../figures/{file.name}\n:alt: {entry.title}\n```" for file in pictures(entry.name)]
    command = COMMANDS[entry.kind]
    source = Path("..") / ".." / entry.file.resolve().relative_to(DOCS.parent).as_posix()
    body = entry.file.read_text(encoding="utf-8")
    others = sorted(
        file.name
        for file in entry.file.parent.iterdir()
        if file.is_file() and file != entry.file and entry.file.parent.name == entry.name
    )
    return page(
        f"(scene-{entry.name})=\n# {entry.title}",
        f"Scene `{entry.name}`" + (f", {entry.group.lower()}." if entry.group else "."),
        "\n\n".join(" ".join(part.split()) for part in entry.description.strip().split("\n\n")),
        *images,
        f"```sh\n{command} {entry.name}\ngranfabric scenes --copy {entry.name}      # a folder of your own\n```",
        "## The scene",
        f"```toml\n{body.rstrip()}\n```",
        f"Beside it in `{source.parent.as_posix().removeprefix('../../')}`: "
        + ", ".join(f"`{name}`" for name in others)
        + "."
        if others
        else "",
    )


def pages() -> dict[str, str]:
    """The gallery and one page a scene."""
    entries = [entry for entry in shipped().values() if not entry.file.parent.name.startswith("effects")]
    result = {f"generated/catalogue/{entry.name}": _scene(entry) for entry in entries}
    parts = []
    for kind in ORDER:
        of_kind = [entry for entry in entries if entry.kind == kind]
        groups = list(dict.fromkeys(entry.group for entry in of_kind))
        for group in groups:
            title = f"{HEADINGS[kind]}: {group[0].lower()}{group[1:]}" if group else HEADINGS[kind]
            cards = "\n\n".join(_card(entry) for entry in of_kind if entry.group == group)
            parts.append(f"## {title}\n\n::::{{grid}} 1 2 2 3\n:gutter: 2\n\n{cards}\n::::")
    listing = "\n".join(entry.name for kind in ORDER for entry in entries if entry.kind == kind)
    result["generated/catalogue/index"] = page(
        "# Catalogue of scenes",
        "Every shipped scene runs by its name and can be copied into a folder of your own: `granfabric scenes` lists "
        "them, `granfabric scenes --copy NAME` copies one. What they are compared with: {doc}`/guide/scenes`. "
        "The pictures are made by `python docs/scene_figures.py`.",
        *parts,
        f"```{{toctree}}\n:hidden:\n\n{listing}\n```",
    )
    return result
