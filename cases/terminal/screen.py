"""What a run says while it works and at its end, on the screen and in a log file beside its results."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

PLAIN_WIDTH = 130
"""Least width of tables that go to a file or a pipe."""
ROOMS = ("constitutive", "fem", "dem_ref", "cases")
"""Loggers whose messages belong to a run."""
NOTED_FRACTION = 0.01
"""Progress between two lines on it, of the whole."""


class Screen:
    """Progress and messages on a terminal; plain lines elsewhere.

    Parameters
    ----------
    console : Console, optional
    quiet : bool
        Nothing but warnings and failures. The log file gets everything all the same.
    verbose : bool
        Also each step, and what solvers note down.

    Attributes
    ----------
    command : sequence of str or None
        Words after the program's name for the first line of the log file; those of this process if None.
    """

    def __init__(self, console: Console | None = None, quiet: bool = False, verbose: bool = False) -> None:
        self.console = console or Console(highlight=False)
        self.quiet, self.verbose = quiet, verbose and not quiet
        self.command: Sequence[str] | None = None
        self._log: Path | None = None
        self._early: list[str] = []
        if not self.console.is_terminal:
            self.console.width = max(self.console.width, PLAIN_WIDTH)

    def say(self, text: str, insist: bool = False) -> None:
        """One line; warnings, which begin with that word, and what insists are said in any case."""
        if not self.quiet or insist or text.startswith("warning:"):
            self.console.print(text, markup=False, soft_wrap=True)
        self.log(text)

    def note(self, text: str) -> None:
        """One line for those who want to know more: on the screen only if verbose."""
        if self.verbose:
            self.console.print(text, markup=False, soft_wrap=True)
        self.log(text)

    def log(self, text: str) -> None:
        """Lines for the log file, with the time; kept until there is one. A full disk ends no run."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        lines = [f"{now} {line}\n" for line in text.splitlines()]
        if self._log is None:
            self._early += lines
            return
        try:
            with self._log.open("a", encoding="utf-8") as file:
                file.writelines(lines)
        except OSError:
            return

    def keep_log(self, file: Path, versions: dict[str, str]) -> None:
        """From now on write everything to a log file, what was said so far included; an existing one is gone on with.

        Parameters
        ----------
        file : Path
        versions : dict of str to str
            Of everything that can change a number, for the first line.
        """
        if self._log == file:
            return
        early, self._early, self._log = self._early, [], file
        self.log(" ".join(["granfabric", *map(_quoted, sys.argv[1:] if self.command is None else self.command)]))
        self.log(", ".join(f"{name} {text}" for name, text in versions.items()))
        try:
            with file.open("a", encoding="utf-8") as open_file:
                open_file.writelines(early)
        except OSError:
            return

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Note down what the rooms log within the block."""
        handler = _Noting(self)
        loggers = [logging.getLogger(name) for name in ROOMS]
        before = [logger.level for logger in loggers]
        for logger in loggers:
            logger.addHandler(handler)
            logger.setLevel(logging.INFO)
        try:
            yield
        finally:
            for logger, level in zip(loggers, before):
                logger.removeHandler(handler)
                logger.setLevel(level)

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
            disable=self.quiet or not self.console.is_terminal,
        )
        noted, said = -1.0, ""
        with bar:
            task = bar.add_task(what, total=total, text="")

            def advance(completed: float, text: str) -> None:
                nonlocal noted, said
                bar.update(task, completed=completed, text=text)
                fraction = completed / total if total else 1.0
                if self.verbose and text != said and (fraction >= noted + NOTED_FRACTION or fraction < noted):
                    noted, said = fraction, text
                    self.note(f"{what}: {fraction:.0%}, {text}")

            yield advance

    def table(self, title: str, names: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[str] = ()) -> None:
        """Short table, numbers to the right, columns of words to the left."""
        table = Table(box=None, pad_edge=False)
        for name in names:
            table.add_column(Text(name), justify="left" if name in words else "right", no_wrap=True)
        for row in rows:
            table.add_row(*(Text(cell) for cell in row))  # names with brackets are no markup
        if not self.quiet:
            self.console.print(title, markup=False, soft_wrap=True, style="bold")
            self.console.print(table)
        plain = Console(highlight=False, width=1000, color_system=None, force_terminal=False)
        with plain.capture() as capture:
            plain.print(table)
        self.log(f"{title}\n{capture.get()}")


class _Noting(logging.Handler):
    """Hands messages of loggers to a screen."""

    def __init__(self, screen: Screen) -> None:
        super().__init__(logging.INFO)
        self._screen = screen

    def emit(self, record: logging.LogRecord) -> None:
        """Note one message down."""
        self._screen.note(record.getMessage())


def _quoted(word: str) -> str:
    return word if word.isprintable() and " " not in word else repr(word)


def spread(count: int, shown: int) -> list[int]:
    """At most `shown` indices of `count` rows, evenly spread, first and last among them."""
    if count <= shown:
        return list(range(count))
    return sorted({round(place * (count - 1) / (shown - 1)) for place in range(shown)})
