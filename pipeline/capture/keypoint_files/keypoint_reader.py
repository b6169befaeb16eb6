"""Keypoint formats: a module of ``pipeline.capture.keypoint_files.readers`` each, or an object of another package.

A module declares its format by ``reader`` above the function that reads a frame, and has its rows of the table of
formats in its docstring: ``docs/reference/reader-tables.md`` is made of them. Other packages add formats by entry
points of the group ``multicap.readers``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.capture.keypoint_files.people import KeypointsError, People
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.core.parsing import read_json
from pipeline.core.runtime.plugins import FormatReader


def load_json(path: Path) -> Any:
    """Parsed JSON of a file; raises ``UnreadableError``."""
    return read_json(path.read_bytes())


@dataclass(frozen=True, slots=True, eq=False)
class KeypointReader(FormatReader):
    """Reader of a keypoint format.

    Its functions raise ``TypeError``, ``KeyError`` or ``UnreadableError`` if the content is not in the format, and
    ``KeypointsError`` if it can't be used, such as for a frame without a number or with the number of another one.

    Parameters
    ----------
    name
        Name of the format, or of its program, for users.
    read
        Function that reads the people of a frame from the content of its file, or from an entry of ``split_frames``. It
        raises ``CrowdError`` if there are too many people.
    suffixes
        Endings of the format's files, in lower case with their points.
    load
        Function that opens a file and gives its content. Formats with an ending in common have one function.
    is_content
        Test of a file's content, for endings that several formats have; ``None``: any content is taken.
    fields
        Fields of an object of JSON that tell the format; an object with the fields of two formats is refused.
    rank
        Place among the formats of an ending: the lowest is asked first.
    split_frames
        Function that splits the content of a file of all frames by their numbers, and returns ``None`` for the content
        of a single frame; ``None``: every file has a single frame.
    is_frame
        Test for the content of a single frame in a file with a number in its name.
    """

    read: Callable[[Any, KeypointReading], People]
    suffixes: tuple[str, ...] = (".json",)
    load: Callable[[Path], Any] = load_json
    is_content: Callable[[Any], bool] | None = None
    fields: tuple[str, ...] = ()
    rank: int = 0
    split_frames: Callable[[Any], Mapping[int, Any] | None] | None = None
    is_frame: Callable[[Any], bool] | None = None

    def frames(self, content: Any, number: int | None) -> Mapping[int, Any]:
        """Contents of the frames of a file by their numbers; ``number`` is the number in the name of the file.

        Raises ``KeypointsError`` if the file has a single frame and no number.
        """
        is_frame = number is not None and self.is_frame is not None and self.is_frame(content)
        frames = None if self.split_frames is None or is_frame else self.split_frames(content)
        if frames is not None:
            return frames
        if number is None:
            message = f"The file is read as {self.name}'s of a single frame, which has its number in its name."
            raise KeypointsError(f"{message} Name it like 000000{self.suffixes[0]}.")
        return {number: content}


def reader(name: str, **options: Any) -> Callable[[Callable[[Any, KeypointReading], People]], KeypointReader]:
    """Declare a function as the reader of a format; options are the parameters of ``KeypointReader``.

    Parameters
    ----------
    name
        Name of the format for users.
    options
        Parameters of ``KeypointReader``: suffixes and what tells the format.

    Returns
    -------
    callable
        Decorator of a function that takes loaded content and a ``KeypointReading``, and returns people in pixels.

    Examples
    --------
    >>> import numpy as np
    >>> @reader("Studio", suffixes=(".studio",), load=Path.read_text)
    ... def read_frame(content, reading):
    ...     people = np.array([line.split() for line in content.splitlines()], float).reshape(-1, 17, 3)
    ...     return reading.people(people, reading.layout(17, "points"))
    >>> read_frame.suffixes
    ('.studio',)
    """
    return lambda read: KeypointReader(name, read, **options)
