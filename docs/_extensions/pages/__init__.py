"""Pages of the site that are written from the program: its schema, commands, constants, docstrings and scenes.

Each module has a function that returns pages as a dictionary from a path below `docs/` (without ending) to Markdown.
Only `mathml` and the extension beside this folder know Sphinx, so that tests can read the pages without it.
"""
