"""Choose the reader of a calibration file, and read it."""

from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path, PurePath

from defusedxml.ElementTree import fromstring

from pipeline.calibration import readers
from pipeline.calibration.advice import COMMA_HINT, SUPPORTED, comma_in, comma_message, other_format, with_points
from pipeline.calibration.contents import CameraFile, possible_units, question, scaled
from pipeline.calibration.formats import CalibrationReader
from pipeline.calibration.readers import colmap, qca
from pipeline.calibration.vertical import AXES, turned_upright
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.arguments import checked
from pipeline.core.options.job_choices import UNITS_M, Units, Up
from pipeline.core.parsing import UnreadableError, in_utf_8, parse
from pipeline.core.paths import StrPath
from pipeline.core.problems import session_codes
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import CALIBRATION_UNPOSED
from pipeline.core.runtime.plugins import load_readers

Reader = Callable[[bytes, str], CameraFile]

# 128 cameras take about 200 kB in the most verbose format.
MAX_BYTES = 4 * 2**20


@cache
def calibration_readers() -> tuple[CalibrationReader, ...]:
    """Readers of other packages, then this one's."""
    return load_readers(CalibrationReader, readers)


def reader_of_file(name: str, content: bytes, head: bytes) -> CalibrationReader | None:
    """Choose a reader by the file's ending, or by its content; ``head`` is the content without white space before it.

    Qualisys names XML files ``.txt``.
    """
    known, suffix = calibration_readers(), PurePath(name).suffix.lower()
    by_suffix = [each for each in known if suffix in each.suffixes]
    by_content = [each for each in known if each.is_content is not None and each.is_content(content)]
    choices = [
        *(each for each in by_content if each in by_suffix),
        *(each for each in by_suffix if each.is_content is None),
        *(each for each in by_content if not each.suffixes),
        *(each for each in known if head.startswith(each.starts)),
    ]
    return choices[0] if choices else None


def reader_of_root(root: str) -> CalibrationReader | None:
    """Choose the reader of XML by its root element."""
    return next((each for each in calibration_readers() if any(fnmatchcase(root, name) for name in each.roots)), None)


def _read_xml(content: bytes, file: str) -> CameraFile:
    """Read XML by its root element; Qualisys QCA if the file is not XML, so that its reader reports the problem."""
    try:
        root = str(parse(fromstring, content).tag)
    except UnreadableError:
        root = qca.ROOT
    reader = reader_of_root(root)
    if reader is None:
        message = f"The XML file has the root element {root[:40]}, which no supported format has."
        raise InputError([Problem(session_codes.CALIBRATION_FORMAT, message, file=file, hint=SUPPORTED)])
    return reader(content, file)


# Starts of files that are no text: zip archives and pickles.
_BINARY = (b"PK\x03\x04", b"\x80")


def _head(content: bytes) -> bytes:
    return content.lstrip(b"\xef\xbb\xbf \t\r\n")


@checked
def read_calibration(path: StrPath, units: Units | None = None, up: Up = "z") -> tuple[Camera, ...]:
    """Read cameras from a file in any supported format.

    Parameters
    ----------
    path, units, up
        See ``read_contents``.

    Returns
    -------
    tuple of Camera
        Cameras in the order of the file, in metres.

    Raises
    ------
    InputError
        With all problems of the file.

    Examples
    --------
    >>> [camera.name for camera in read_calibration(folder / "calibration.json")]
    ['cam_00', 'cam_01', 'cam_02']
    """
    return read_contents(Path(path), units, up).cameras


def read_intrinsics(path: Path) -> CameraFile:
    """Read a file in any supported format for the intrinsics of its cameras; poses are missing, or in any unit."""
    contents = _read(path)
    return replace(contents, cameras=(*contents.cameras, *contents.unposed), unposed=())


def read_contents(path: Path, units: Units | None = None, up: Up = "z") -> CameraFile:
    """Read a file in any supported format.

    Parameters
    ----------
    units
        Unit of the lengths in the file, for formats that don't determine it; ``None``: metres, if the cameras are then
        as far apart as in a rig.
    up
        Axis that points up, of the world to which the format's own axes are turned; it becomes Z.

    Returns
    -------
        Cameras in the order of the file, with lengths in metres, and what the format says of units and axes. Formats
        without sizes of pictures give ``UNKNOWN_SIZE``.

    Raises
    ------
    InputError
        With all problems of the file. A unit that can't be known is asked for.

    Examples
    --------
    >>> import json, tempfile
    >>> camera = {"name": "left", "size_px": [1920, 1080], "matrix": [[900, 0, 959.5], [0, 900, 539.5], [0, 0, 1]],
    ...           "distortion": [], "rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "translation_m": [0, 1.5, 4]}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "rig.json"
    ...     _ = path.write_text(json.dumps({"schema_version": 1, "cameras": [camera]}), encoding="utf-8")
    ...     contents = read_contents(path)
    >>> contents.format, contents.unit, [camera.name for camera in contents.cameras]
    ('Multicap JSON', 'm', ['left'])
    """
    contents = _in_metres(path, units)
    if up == "z":
        return contents
    axes = f"{up.upper()} up, as stated: turned to Z up"
    return replace(contents, cameras=turned_upright(contents.cameras, AXES[up]), axes=axes)


def _in_metres(path: Path, units: Units | None) -> CameraFile:
    contents = _read(path)
    if not contents.cameras:
        count = len(contents.unposed)
        message = f"The file has the intrinsics of {count} camera{'s' * (count != 1)} and no rotation or translation."
        hint = (
            "Pack this file and the one with the extrinsics into one zip; or make a calibration from a board or from "
            "people, which takes these intrinsics as they are."
        )
        raise _refusal(path, CALIBRATION_UNPOSED, message, hint)
    if contents.unit is not None:
        if units not in (None, "m", contents.unit):
            message = f"The format determines the unit of lengths, {contents.unit}; it is not {units}."
            raise _refusal(path, session_codes.CALIBRATION_UNITS, message, "Omit the units.")
        return contents
    if units is None and (possible := possible_units(contents.cameras)) != ("m",):
        stated = " or ".join(f"`--units {unit}`" for unit in possible)
        hint = f"State the unit: {stated}, `units` of the manifest, or the unit of length on the page."
        raise _refusal(path, session_codes.CALIBRATION_UNITS_UNSTATED, question(contents.cameras, possible), hint)
    return replace(contents, cameras=tuple(scaled(camera, UNITS_M[units or "m"]) for camera in contents.cameras))


def _refusal(path: Path, code: Code, message: str, hint: str | None = None) -> InputError:
    return InputError([Problem(code, message, file=path.name, hint=hint)])


def _read(path: Path) -> CameraFile:
    """Contents of a file, in its unit if the format does not determine one."""
    try:
        if path.is_dir():
            message = "This is a folder, not a calibration file."
            raise _refusal(
                path, session_codes.CALIBRATION_FORMAT, message, "Name the file; pack several files into one zip."
            )
        if not path.is_file():
            raise _refusal(path, session_codes.CALIBRATION_MISSING, "The calibration file does not exist.")
        num_bytes = path.stat().st_size
        if num_bytes > MAX_BYTES:
            raise _refusal(
                path,
                session_codes.CALIBRATION_TOO_LARGE,
                f"The file has {num_bytes / 2**20:.0f} MiB; at most {MAX_BYTES // 2**20} MiB are allowed.",
                "Check that it is the calibration file.",
            )
        content = path.read_bytes()
    except OSError as error:
        raise _refusal(
            path, session_codes.CALIBRATION_UNREADABLE, "The file can't be read.", "Check its permissions."
        ) from error
    content = in_utf_8(content)
    reader: Reader | None = None
    if path.suffix.lower() != ".xml":
        reader = reader_of_file(path.name, content, _head(content))
    if reader is None and (path.suffix.lower() == ".xml" or _head(content).startswith(b"<")):
        reader = _read_xml
    if reader is None:
        raise _refusal(path, session_codes.CALIBRATION_FORMAT, *other_format(path.name))
    try:
        return reader(content, path.name)
    except InputError:
        comma = None if content.startswith(_BINARY) else comma_in(content)
        if comma is None:
            raise
        if colmap.is_text(content) or _head(content).startswith(b"<"):
            # Spaces or quotes separate the numbers.
            contents = reader(with_points(content), path.name)
            note = f"{path.name}: the numbers have decimal commas, such as {comma}, and are read so."
            return replace(contents, notes=(*contents.notes, note))
        raise _refusal(path, session_codes.CALIBRATION_UNREADABLE, comma_message(comma), COMMA_HINT) from None
