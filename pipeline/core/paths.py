"""Paths as programs give them."""

import os

StrPath = str | os.PathLike[str]
"""Path of a file or folder: text, or an object such as ``pathlib.Path``."""
