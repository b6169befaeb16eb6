"""Calibrations of several files, in a zip: EasyMocap, COLMAP, bioCV, OpenCap, and OpenCV with a file a camera.

Rows of the table of formats:

| bioCV | `.zip` with a file `NAME.calib` for each camera | mm | as calibrated |
"""

import io
import zipfile
from collections.abc import Mapping
from pathlib import PurePosixPath

from pipeline.calibration.advice import COMMA_HINT, comma_in, comma_message, other_members
from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers import colmap, opencv, pickles
from pipeline.calibration.readers.file_storage import read_object, read_xml, read_yaml
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.errors import InputError, Problem
from pipeline.core.parsing import UnreadableError, in_utf_8, parse
from pipeline.core.problems.session_codes import CALIBRATION_FORMAT, CALIBRATION_UNREADABLE

_MAX_ENTRIES = 2 * MAX_CAMERAS
_MAX_UNPACKED_BYTES = 16 * 2**20
_PARSERS = {".yml": read_yaml, ".yaml": read_yaml, ".xml": read_xml, ".json": read_object}
_OPENCAP = frozenset({"cameraIntrinsicsExtrinsics.pickle", "cameraIntrinsics.pickle"})
# Numbers of a bioCV file: width, height, K, a transform of 4 x 4, and at least 4 distortion coefficients.
_MIN_BIOCV_NUMBERS = 2 + 9 + 16 + 4


@reader("Archive of several files", suffixes=(".zip",), starts=(b"PK\x03\x04",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a zip; ``InputError`` lists all its problems."""
    try:
        members = parse(_unpack, content)
        contents = _read_unless_commas(members, file)
    except UnreadableError as error:
        message = "The archive, or a file in it, is damaged, not in its format, or too large."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error
    if contents is None:
        message, hint = other_members(members)
        raise InputError([Problem(CALIBRATION_FORMAT, message, file=file, hint=hint)])
    return contents


def _read_unless_commas(members: Mapping[str, bytes], file: str) -> CameraFile | None:
    """Contents of the files; decimal commas are the reason that is named of files that can't be read."""
    try:
        return _read_members(members, file)
    except (InputError, UnreadableError):
        commas = [comma for member in members.values() if (comma := comma_in(member)) is not None]
        if not commas:
            raise
        problem = Problem(CALIBRATION_UNREADABLE, comma_message(commas[0]), file=file, hint=COMMA_HINT)
        raise InputError([problem]) from None


def _unpack(content: bytes) -> dict[str, bytes]:
    """Read all files by their base names; hidden files are left out."""
    members: dict[str, bytes] = {}
    left = _MAX_UNPACKED_BYTES
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        entries = archive.infolist()
        if len(entries) > _MAX_ENTRIES:
            raise UnreadableError
        for entry in entries:
            name = _name(PurePosixPath(entry.filename))
            if entry.is_dir() or name.startswith("."):
                continue
            with archive.open(entry) as member:
                members[name] = member.read(left + 1)
            left -= len(members[name])
            if left < 0:
                raise UnreadableError
            members[name] = in_utf_8(members[name])
    return members


def _name(path: PurePosixPath) -> str:
    """Base name of a file; of OpenCap's files, which have one name in the folders of all cameras, the folder's."""
    return f"{path.parent.name}.pickle" if path.name in _OPENCAP and path.parent.name else path.name


def _read_members(members: Mapping[str, bytes], file: str) -> CameraFile | None:
    if {"intri.yml", "extri.yml"} <= members.keys():
        return opencv.read_fields(read_yaml(members["intri.yml"]) | read_yaml(members["extri.yml"]), file)
    if {"cameras.txt", "images.txt"} <= members.keys():
        cameras_text, images_text = (members[name].decode("utf-8", "replace") for name in ("cameras.txt", "images.txt"))
        return colmap.read_parts(cameras_text, images_text, file)
    stems = {name: PurePosixPath(name) for name in sorted(members)}
    biocv = {path.stem: members[name] for name, path in stems.items() if path.suffix == ".calib"}
    if biocv:
        raw = [_raw_biocv(name, content) for name, content in biocv.items()]
        return Reading(file).contents("bioCV", raw, "mm")
    pickled = {path.stem: members[name] for name, path in stems.items() if path.suffix in {".pickle", ".pkl"}}
    if pickled:
        return pickles.read_members(pickled, file)
    parsed = {
        path.stem: _PARSERS[path.suffix](members[name]) for name, path in stems.items() if path.suffix in _PARSERS
    }
    return opencv.read_fields({"cameras": parsed}, file)


def _raw_biocv(name: str, content: bytes) -> RawCamera:
    """Camera of a file with width, height, K, the transform from world to camera (4 x 4), and the distortion."""
    numbers = parse(_floats, content)
    if len(numbers) < _MIN_BIOCV_NUMBERS:
        raise UnreadableError
    transform = [numbers[11 + 4 * row : 15 + 4 * row] for row in range(4)]
    if transform[3] != [0.0, 0.0, 0.0, 1.0]:
        raise UnreadableError
    return RawCamera(
        name=name,
        size_px=numbers[:2],
        matrix=[numbers[2 + 3 * row : 5 + 3 * row] for row in range(3)],
        distortion=numbers[27:],
        rotation=[row[:3] for row in transform[:3]],
        translation_m=[row[3] for row in transform[:3]],
    )


def _floats(content: bytes) -> list[float]:
    return [float(word) for word in content.decode("ascii").split()]
