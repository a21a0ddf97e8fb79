"""Public names: one page a module. What is listed comes from the sources, what is said about it from autodoc."""

from __future__ import annotations

import inspect
from importlib import import_module

from .docstring import tidy
from .equations import link
from .markdown import page, prose, table
from .sources import ROOMS, Thing, things

TITLES = {
    "granfabric": "The front",
    "granfabric.constitutive": "The point law",
    "granfabric.fem": "The finite element host",
    "granfabric.dem_ref": "The reference DEM",
    "granfabric.cases": "Scenes, commands, pictures",
}
DIRECTIVES = {"class": "autoclass", "function": "autofunction"}
HEADINGS = {"class": "Classes", "function": "Functions", "data": "Constants"}


def modules(package: str) -> list[Thing]:
    """Modules of a package, the package itself first."""
    return [thing for thing in things(package) if thing.kind == "module"]


def _documented(thing: Thing) -> list[str]:
    if thing.kind == "data":  # not every constant can be imported and shown: its text is enough
        body = [f"   {line}".rstrip() for line in tidy(thing.text.splitlines())]
        return [f".. py:data:: {thing.name}", "", *body, ""]
    return [f".. {DIRECTIVES[thing.kind]}:: {thing.name}", *(["   :members:"] if thing.kind == "class" else []), ""]


def _module(module: Thing, package: str) -> str:
    inside = [thing for thing in things(package) if thing.kind in HEADINGS and thing.file == module.file]
    inside = [thing for thing in inside if thing.kind != "module"]
    ordered = [thing for kind in HEADINGS for thing in inside if thing.kind == kind]
    lines = [f".. automodule:: {module.name}", "   :no-members:", ""]
    contents = table(("name", "what it is"), [(link(thing, short=True), prose(thing.summary)) for thing in ordered])
    body = [line for thing in ordered for line in _documented(thing)]
    return page(
        f"# {module.name.removeprefix('granfabric.')}",
        "```{eval-rst}\n" + "\n".join(lines) + "\n```",
        contents if len(ordered) > 1 else "",
        "```{eval-rst}\n" + "\n".join(body) + "\n```" if body else "",
    )


def _exported(package: str) -> list[tuple[str, str]]:
    """Names that a package declares in `__all__`, with links to where they are defined."""
    imported = import_module(package)
    rows = []
    for name in getattr(imported, "__all__", ()):
        value = getattr(imported, name)
        home = f"{getattr(value, '__module__', package)}.{getattr(value, '__qualname__', name)}"
        first = (inspect.getdoc(value) or "").split("\n\n")[0]
        rows.append((f"{{py:obj}}`{name} <{home}>`", prose(first)))
    return rows


def pages() -> dict[str, str]:
    """A page a package that lists its modules, and a page a module."""
    result = {}
    for package, title in TITLES.items():
        rows, listing = [], []
        for module in modules(package):
            if module.name == package:
                continue
            if module.name.startswith("granfabric.cases."):
                rows.append((f"`{module.name}`", prose(module.summary)))
                continue
            place = module.name.removeprefix("granfabric.").replace(".", "/") + ("/index" if _is_folder(module) else "")
            result[f"generated/api/{place}"] = _module(module, package)
            rows.append((f"[`{module.name}`](/generated/api/{place})", prose(module.summary)))
            listing.append(f"/generated/api/{place}")
        own = modules(package)[0]
        exported = _exported(package)
        short = package.removeprefix("granfabric.")
        tree = "\n".join(listing)
        result[f"generated/api/{short}"] = page(
            f"# {title}: `{package}`",
            prose(own.summary),
            table(("name", "what it is"), exported) if exported else "",
            table(("module", "what it holds"), rows) if rows else "",
            f"```{{toctree}}\n:hidden:\n\n{tree}\n```" if listing else "",
        )
    return result


def _is_folder(module: Thing) -> bool:
    return module.file.stem == "__init__"


assert set(TITLES) == set(ROOMS)
