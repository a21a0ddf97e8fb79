"""Which scenes are shipped, and where a named scene lies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from shutil import copy2

from granfabric.cases.errors import InputError, unknown

from .toml_file import read_table

HOME = Path(__file__).resolve().parent.parent / "scenes"
MATERIALS = HOME / "materials"
"""Folder of the shipped material files, as `granfabric dem` and `granfabric verify` write them."""
SCHEMA = HOME / "schema.json"
DIRECTIVE = "#:schema "
"""First words of a comment from which editors (taplo, Even Better TOML) learn where the schema of a file lies."""


@dataclass(frozen=True)
class Entry:
    """One shipped scene: its name, kind, heading, one-line title, text and file."""

    name: str
    kind: str
    group: str
    title: str
    description: str
    file: Path


def shipped() -> dict[str, Entry]:
    """All shipped scenes by name, points first, then by heading."""
    entries = []
    for file in HOME.glob("*/*.toml"):
        if file.parent == MATERIALS:
            continue
        data = read_table(file)
        entries.append(
            Entry(file.stem, data["kind"], data.get("group", ""), data["title"], data.get("description", ""), file)
        )
    entries.sort(key=lambda entry: (entry.kind != "point", entry.kind, entry.group, entry.name))
    return {entry.name: entry for entry in entries}


def find(scene: str) -> Path:
    """File of a scene given as a shipped name, a file, or a folder with one scene file in it.

    A shipped name wins over a folder of the same name; write ``./NAME`` for the folder.

    Raises
    ------
    InputError
        If there is nothing of that name, or it is a mesh.
    """
    path = Path(scene)
    looks_like_path = path.suffix == ".toml" or len(path.parts) > 1 or scene.startswith(".")
    if not looks_like_path:
        names = shipped()
        if scene in names:
            return names[scene].file
        if not path.exists():
            raise InputError(f"{unknown('the scene', scene, names)} (a scene file has the ending .toml)")
    if path.is_dir():
        files = sorted(file for file in path.glob("*.toml") if file.is_file())
        if len(files) != 1:
            raise InputError(f"the folder {scene!r} holds {len(files)} files with the ending .toml; name one of them")
        return files[0]
    if not path.exists():
        raise InputError(f"the scene file {scene!r} does not exist")
    if path.suffix.lower() == ".msh":
        raise InputError(
            f"{scene!r} is a mesh and no scene: `granfabric mesh {scene}` shows it, and a scene takes it by "
            f'[mesh] file = "{path.name}"'
        )
    return path


def files_like(beginning: str) -> list[str]:
    """Scene files, and folders, whose path begins so; for the completion of a shell."""
    folder, _, name = beginning.rpartition("/")
    place = Path(folder or ("/" if beginning.startswith("/") else "."))
    prefix = beginning[: len(beginning) - len(name)]
    found = []
    for entry in sorted(place.iterdir()) if place.is_dir() else []:
        if entry.name.startswith(name) and (name or not entry.name.startswith(".")):
            if entry.is_dir():
                found.append(f"{prefix}{entry.name}/")
            elif entry.suffix == ".toml":
                found.append(f"{prefix}{entry.name}")
    return found


def is_path(name: str) -> bool:
    """Whether the name of a material is a file's, not a shipped one."""
    return Path(name).suffix == ".toml" or len(Path(name).parts) > 1


def material(name: str, folder: Path) -> Path:
    """File of a material given as a shipped name, or as a file relative to a folder.

    Raises
    ------
    InputError
        If a name without the ending .toml is not a shipped one.
    """
    if is_path(name):
        return folder / Path(name).expanduser()
    names = sorted(file.stem for file in MATERIALS.glob("*.toml"))
    if name not in names:
        raise InputError(f"{unknown('material_file =', name, names)} (a material file has the ending .toml)")
    return MATERIALS / f"{name}.toml"


def copy(name: str, folder: Path) -> list[Path]:
    """Copy a shipped scene with its mesh into a folder to start from; nothing is overwritten.

    The JSON schema comes along, and the scene's first line names it, so that editors know the legal keys.

    Returns
    -------
    list of Path
        The copies, the scene file first.
    """
    names = shipped()
    if name not in names:
        raise InputError(unknown("the shipped scene", name, names))
    file = names[name].file
    own_folder = len(list(file.parent.glob("*.toml"))) == 1
    sources = [file]
    if own_folder:
        sources += sorted(other for other in file.parent.iterdir() if other.is_file() and other != file)
    schema = folder / SCHEMA.name
    if not schema.is_file() or schema.read_bytes() != SCHEMA.read_bytes():
        sources.append(SCHEMA)
    targets = [folder / source.name for source in sources]
    for target in targets:
        if target.exists():
            raise InputError(f"{str(target)!r} exists already and is not overwritten; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for source, target in zip(sources[1:], targets[1:]):
            copy2(source, target)
        text = file.read_text(encoding="utf-8")
        targets[0].write_text(f"{DIRECTIVE}{SCHEMA.name}\n" + _without_directive(text), encoding="utf-8")
    except OSError as error:
        raise InputError(f"the folder {str(folder)!r} cannot be written: {error.strerror}") from error
    return targets


def _without_directive(text: str) -> str:
    first, _, rest = text.partition("\n")
    return rest if first.startswith(DIRECTIVE) else text
