"""Modules, functions and classes of the rooms, read from their sources without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

HOME = Path(__file__).resolve().parents[3]
ROOMS = {"granfabric": "api", **{f"granfabric.{room}": room for room in ("constitutive", "fem", "dem_ref", "cases")}}
"""Import name of each package and the folder that holds it."""


@dataclass(frozen=True)
class Thing:
    """A documented module, class, function, method or constant."""

    kind: str
    name: str
    text: str
    file: Path
    line: int

    @property
    def summary(self) -> str:
        """First sentence of its docstring."""
        first = self.text.strip().split("\n\n")[0]
        return " ".join(first.split())


def _name(file: Path, folder: Path, package: str) -> str:
    parts = file.relative_to(folder).with_suffix("").parts
    return ".".join([package, *(part for part in parts if part != "__init__")])


def _inside(module: ast.Module, name: str, file: Path) -> Iterator[Thing]:
    following = [*module.body[1:], None]
    for node, after in zip(module.body, following):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            text = ast.get_docstring(node)
            kind = "class" if isinstance(node, ast.ClassDef) else "function"
            if text:
                yield Thing(kind, f"{name}.{node.name}", text, file, node.lineno)
            if isinstance(node, ast.ClassDef):
                for part in node.body:
                    inner = isinstance(part, ast.FunctionDef) and not part.name.startswith("_")
                    if inner and (text := ast.get_docstring(part)):
                        yield Thing("method", f"{name}.{node.name}.{part.name}", text, file, part.lineno)
        is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and is_text and isinstance(after.value.value, str):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Name) and not target.id.startswith("_"):
                yield Thing("data", f"{name}.{target.id}", after.value.value, file, node.lineno)


@cache
def things(package: str) -> tuple[Thing, ...]:
    """What a package documents, module by module, each module followed by what it holds."""
    folder = HOME / ROOMS[package]
    found = []
    for file in sorted(folder.rglob("*.py"), key=lambda file: file.relative_to(folder).parts):
        if file.stem == "__main__":
            continue
        module = ast.parse(file.read_text(encoding="utf-8"))
        name = _name(file, folder, package)
        found.append(Thing("module", name, ast.get_docstring(module) or "", file, 1))
        found += _inside(module, name, file)
    return tuple(found)
