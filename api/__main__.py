"""`python -m granfabric`."""

from granfabric.cases.__main__ import main

if __name__ == "__main__":
    main()
