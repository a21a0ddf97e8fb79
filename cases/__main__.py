"""`granfabric`, and `python -m granfabric`."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point of the console script; Ctrl-C is answered also while modules are imported."""
    try:
        from granfabric.cases.commands.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("granfabric: interrupted\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
