"""Links, tables of contents, equations, findings and the README hold together. Nothing here needs Sphinx."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pages import api, catalogue, commands, equations, files, findings, glossary, scene_keys, state
from pages.docstring import tidy
from pages.sources import Thing

HOME = Path(__file__).resolve().parents[2]
DOCS = HOME / "docs"
WRITTEN = sorted(file for folder in (".", "guide", "theory", "reference") for file in (DOCS / folder).glob("*.md"))
GENERATED = {
    name: text
    for source in (api, catalogue, commands, files, findings, glossary, scene_keys, state)
    for name, text in source.pages().items()
}
TUTORIALS = {f"generated/tutorials/{file.stem}" for file in (DOCS / "tutorials").glob("*.py")}
DOCUMENTS = {
    *(file.relative_to(DOCS).with_suffix("").as_posix() for file in WRITTEN),
    *GENERATED,
    *TUTORIALS,
    "generated/tutorials/index",
}


def sources() -> dict[str, str]:
    texts = {file.relative_to(DOCS).with_suffix("").as_posix(): file.read_text(encoding="utf-8") for file in WRITTEN}
    return {**texts, **GENERATED}


def resolved(name: str, target: str) -> str:
    folder = "" if target.startswith("/") else name.rpartition("/")[0]
    parts: list[str] = []
    for part in f"{folder}/{target}".split("/"):
        if part == "..":
            parts.pop()
        elif part not in ("", "."):
            parts.append(part)
    return "/".join(parts)


def test_every_link_within_the_site_resolves() -> None:
    for name, text in sources().items():
        plain = re.sub(r"```(?!\{).*?```", "", text, flags=re.DOTALL)
        for target in re.findall(r"\{doc\}`(?:[^`<]*<)?([^`<>]+)>?`", plain):
            assert resolved(name, target) in DOCUMENTS, f"{name}: {target}"
        for target in re.findall(r"\]\(([^)#\s]+)\)", plain):
            if "://" in target:
                continue
            place = resolved(name, target)
            assert place in DOCUMENTS or (DOCS / place).is_file(), f"{name}: {target}"
        for target in re.findall(r"```\{(?:image|literalinclude)\} (\S+)", text):
            assert (DOCS / resolved(name, target)).is_file(), f"{name}: {target}"


def test_every_page_is_in_a_table_of_contents() -> None:
    listed = {"index"}
    for name, text in sources().items():
        for body in re.findall(r"```\{toctree\}\n(.*?)```", text, re.DOTALL):
            for line in body.splitlines():
                if line and not line.startswith(":"):
                    if line.endswith("?") and resolved(name, line[:-1]) not in DOCUMENTS:
                        continue
                    target = resolved(name, line.rstrip("?"))
                    assert target in DOCUMENTS, f"{name}: {line}"
                    listed.add(target)
    assert not DOCUMENTS - listed - TUTORIALS


@pytest.mark.parametrize("number", range(1, equations.COUNT + 1))
def test_each_equation_of_the_source_is_found_by_its_number_and_stands_in_the_code(number: int) -> None:
    text = (DOCS / "theory" / "equations.md").read_text(encoding="utf-8")
    entries = re.findall(r"\{equation-entry\} ([\d ]+)\n", text)  # the search of the site does not find numbers alone
    assert [entry.split() for entry in entries if str(number) in entry.split()]
    assert re.search(rf"[Ee]quation {number}\b", text)
    places = equations.places()[number]
    assert any(place.name.startswith("granfabric.constitutive") for place in places)


def test_equation_numbers_are_told_from_intervals_and_indices() -> None:
    def found(text: str, name: str = "granfabric.constitutive.network.arcs") -> set[int]:
        return equations.numbers(Thing("module", name, text, Path(), 1))

    assert found("Loss [Pouragha & Wan 2017, eqs 9, 10] and gain [eq. 13].") == {9, 10, 13}
    assert found("All of it [eqs 3-6 and 8].") == {3, 4, 5, 6, 8}
    assert found("The stress [7]") == {7}
    assert found("An angle in [0, pi], of a list x[0].") == set()
    assert found("An interval [0, 1]", "granfabric.dem_ref.loading.legs") == set()


def test_formulas_of_docstrings_become_literal_blocks() -> None:
    lines = ["Text |a| of `Leg`s:", "", "    x = |y|", "", "* item,", "  goes on *so*", "", "Parameters", "----------"]
    assert tidy([*lines, "a : float", "    Text.", "", "    More."]) == [
        "Text \\|a\\| of `Leg`\\ s:", "", "::", "", "    x = |y|", "", "* item,", "  goes on \\*so\\*", "",
        "Parameters", "----------", "a : float", "    Text.", "", "    More.",
    ]  # fmt: skip


def test_the_table_of_findings_is_that_of_the_scripts() -> None:
    text = findings.README.read_text(encoding="utf-8")
    assert findings.renewed(text) == text, "run `python -m pages.findings` in docs/_extensions"


def test_a_finding_is_read_from_its_header(tmp_path: Path) -> None:
    script = tmp_path / "one.sh"
    lines = ["#!/usr/bin/env bash", "# library: x", "# version: 1", "# expected: a", "#   b", "# seen: c", "set -e"]
    script.write_text("\n".join(lines))
    assert findings.header(script) == {"library": "x", "version": "1", "expected": "a b", "seen": "c"}
    script.write_text("# library: x\n")
    with pytest.raises(ValueError, match="version"):
        findings.header(script)


def test_links_of_readme_and_contributing_resolve() -> None:
    for file in (HOME / "README.md", HOME / "CONTRIBUTING.md", HOME / "findings" / "README.md"):
        for target in re.findall(r"\]\(([^)#\s]+)\)", file.read_text(encoding="utf-8")):
            assert "://" in target or (file.parent / target).exists(), f"{file.name}: {target}"


def test_the_readme_is_short_and_has_its_two_commands() -> None:
    lines = (HOME / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 90
    commands_of = [line for line in lines if line.startswith("python3 -m venv")]
    assert len(commands_of) == 2 and commands_of[1].endswith("-m pytest")


def test_the_citation_names_version_and_source() -> None:
    import tomllib

    text = (HOME / "CITATION.cff").read_text(encoding="utf-8")
    version = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {version}\n" in text
    assert "On the contact gain/loss in granular assemblies" in text
