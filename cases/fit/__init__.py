"""Curves that a user has measured: read, followed by the point law, compared with it, fitted by it."""
