"""What a run says while it works and at its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

PLAIN_WIDTH = 130
"""Least width of tables that go to a file or a pipe."""


class Screen:
    """Progress and messages on a terminal; plain lines elsewhere."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console(highlight=False)
        if not self.console.is_terminal:
            self.console.width = max(self.console.width, PLAIN_WIDTH)

    def say(self, text: str) -> None:
        """One line."""
        self.console.print(text, markup=False, soft_wrap=True)

    def announce_compilation(self, about: int) -> Callable[[], None]:
        """Callback that says that kernels are being compiled, `about` seconds on an ordinary computer."""
        return lambda: self.say(f"compiling kernels (first use, about {about} s)")

    def announce_stop(self) -> None:
        """Answer to Ctrl-C."""
        self.say("stopping after this step (Ctrl-C again stops at once)")

    @contextmanager
    def progress(self, what: str, total: float) -> Iterator[Callable[[float, str], None]]:
        """Bar on a terminal; yields ``advance(completed, text)``."""
        bar = Progress(
            TextColumn(what),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}"),
            console=self.console,
            transient=True,
            disable=not self.console.is_terminal,
        )
        with bar:
            task = bar.add_task(what, total=total, text="")
            yield lambda completed, text: bar.update(task, completed=completed, text=text)

    def table(self, title: str, names: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[str] = ()) -> None:
        """Short table, numbers to the right, columns of words to the left."""
        table = Table(box=None, pad_edge=False)
        for name in names:
            table.add_column(name, justify="left" if name in words else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        self.console.print(title, markup=False, soft_wrap=True, style="bold")
        self.console.print(table)


def spread(count: int, shown: int) -> list[int]:
    """At most `shown` indices of `count` rows, evenly spread, first and last among them."""
    if count <= shown:
        return list(range(count))
    return sorted({round(place * (count - 1) / (shown - 1)) for place in range(shown)})
