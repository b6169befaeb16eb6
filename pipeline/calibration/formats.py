"""Calibration formats: a module of ``pipeline.calibration.readers`` each, or an object of another package.

A module declares its format by ``reader`` above the function that reads it, and has its rows of the table of formats in
its docstring: ``docs/reference/reader-tables.md`` is made of them. Other packages add formats by entry points of the
group ``multicap.readers``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pipeline.calibration.contents import CameraFile
from pipeline.core.runtime.plugins import FormatReader


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReader(FormatReader):
    """Reader of a calibration format; call it with the content of a file and the file's name.

    - ``name``: name of the format for users.
    - ``read``: function that reads the cameras. It raises ``InputError`` with all problems of the file.
    - ``suffixes``: endings of the format's files, in lower case with their points.
    - ``roots``: root elements of its XML files; ``*`` stands for any characters.
    - ``starts``: starts of its files, after white space.
    - ``is_content``: test of a file's content, for endings that several formats have, or for files of any ending.
    """

    read: Callable[[bytes, str], CameraFile]
    suffixes: tuple[str, ...] = ()
    roots: tuple[str, ...] = ()
    starts: tuple[bytes, ...] = ()
    is_content: Callable[[bytes], bool] | None = None

    def __call__(self, content: bytes, file: str) -> CameraFile:
        """Read the cameras of a file."""
        return self.read(content, file)


def reader(name: str, **options: Any) -> Callable[[Callable[[bytes, str], CameraFile]], CalibrationReader]:
    """Declare a function as the reader of a format; options are the parameters of ``CalibrationReader``.

    Parameters
    ----------
    name
        Name of the format for users.
    options
        Parameters of ``CalibrationReader``: suffixes and what tells the format.

    Returns
    -------
    callable
        Decorator of a function that takes the bytes and the name of a file, and returns a ``CameraFile``.

    Examples
    --------
    >>> @reader("Studio", suffixes=(".studio",))
    ... def read(content: bytes, file: str) -> CameraFile:
    ...     return CameraFile("Studio", (), "m")
    >>> read.suffixes
    ('.studio',)
    """
    return lambda read: CalibrationReader(name, read, **options)
