"""`python -m cases` is `granfabric`."""

from .cli import main

main()
