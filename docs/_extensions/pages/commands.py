"""Every command with its arguments and options, as the command line itself declares them."""

from __future__ import annotations

from typing import Any

from .markdown import code, page, table
from .project import command_group


def _written(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return code(parameter.metavar or parameter.name.upper())
    takes = "" if getattr(parameter, "is_flag", False) else f" {parameter.metavar or parameter.type.name.upper()}"
    names = [*parameter.opts, *parameter.secondary_opts]
    return ", ".join(code(f"{name}{takes}") for name in names)


def _default(parameter: Any) -> str:
    value = parameter.default
    if parameter.required:
        return "required"
    if value is None or value is False or callable(value) or "UNSET" in repr(value) or value == []:
        return ""
    return code(value)


def names() -> list[str]:
    """All commands, those within groups as two words."""
    group = command_group()
    found = []
    for name, command in group.commands.items():
        inner = getattr(command, "commands", None)
        found += [f"{name} {part}" for part in inner] if inner else [name]
    return found


def _usage(name: str, command: Any) -> str:
    words = [f"granfabric {name}"]
    for parameter in command.params:
        if parameter.param_type_name == "argument":
            words.append(parameter.metavar or parameter.name.upper())
    return " ".join([*words, "[OPTIONS]"] if any(p.param_type_name == "option" for p in command.params) else words)


def _section(name: str, command: Any) -> str:
    rows = [
        (_written(parameter), _default(parameter), getattr(parameter, "help", None) or "")
        for parameter in command.params
        if getattr(parameter, "help", None) or parameter.param_type_name == "argument"
    ]
    parts = [f"## granfabric {name}", (command.help or "").strip(), f"```sh\n{_usage(name, command)}\n```"]
    return "\n\n".join([*parts, table(("argument or option", "default", "meaning"), rows)] if rows else parts)


def pages() -> dict[str, str]:
    """One page of all commands."""
    group = command_group()
    sections, listed = [], []
    for name, command in group.commands.items():
        inner = getattr(command, "commands", None)
        for full, part in [(f"{name} {key}", value) for key, value in inner.items()] if inner else [(name, command)]:
            sections.append(_section(full, part))
            listed.append((code(f"granfabric {full}"), (part.help or "").strip().split("\n\n")[0]))
    general = [
        (_written(option), _default(option), option.help or "")
        for option in group.params
        if getattr(option, "help", None)
    ]
    return {
        "generated/reference/commands": page(
            "# Commands",
            (group.help or "").strip(),
            table(("command", "what it does"), listed),
            "Exit codes: 0 done; 1 the computation could not finish, and what was reached is on disk; 2 bad input, and "
            "nothing was written.",
            "## Options of all commands\n\n" + table(("option", "default", "meaning"), general) if general else "",
            *sections,
        )
    }
