"""Rigs in OpenCV's FileStorage and in JSON: a mapping or a list of cameras, or a file a camera in a zip.

OpenCV does not determine how a rig is stored; ``fields`` has the names that are read. JARVIS has a file a camera, in
millimetres, with transposed matrices. 4D Association and data sets like it have one JSON object, with flat matrices.

Rows of the table of formats:

| OpenCV FileStorage | `.yml`, `.yaml`, `.xml` (`opencv_storage`), `.json`: a mapping or a list of cameras; or `.zip`
with a file for each camera | `units` | as calibrated |
| JARVIS | `.zip` with a file for each camera, `intrinsicMatrix` | mm; m if the numbers are that small | as calibrated;
matrices are transposed |
| 4D Association, and data sets with its files | `.json`, cameras with `K`, `RT` or `R` and `T`, `imgSize` | `units` |
as calibrated |
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

from pipeline.calibration.advice import other_keys
from pipeline.calibration.contents import CameraFile, possible_units, scaled
from pipeline.calibration.formats import reader
from pipeline.calibration.readers import camchain, easymocap
from pipeline.calibration.readers.fields import has_matrix, is_camera, read_camera, size_names
from pipeline.calibration.readers.file_storage import read_xml, read_yaml
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import UNITS_M
from pipeline.core.parsing import UnreadableError
from pipeline.core.problems.session_codes import CALIBRATION_EMPTY, CALIBRATION_UNREADABLE

_NAMES = ("name", "camera_name", "camera_id", "cam_id", "id", "serial")
_JARVIS = frozenset({"intrinsicMatrix", "distortionCoefficients", "R", "T"})
_4D_ASSOCIATION = "imgSize"


@reader("OpenCV FileStorage", suffixes=(".yml", ".yaml"), starts=(b"%YAML",))
def read_yaml_file(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a YAML file; ``InputError`` lists all its problems."""
    return _read_file_storage(read_yaml, content, file)


@reader("OpenCV FileStorage in XML", roots=("opencv_storage",))
def read_xml_file(content: bytes, file: str) -> CameraFile:
    """Read the cameras of an XML file; ``InputError`` lists all its problems."""
    return _read_file_storage(read_xml, content, file)


def _read_file_storage(parser: Callable[[bytes], Mapping[str, object]], content: bytes, file: str) -> CameraFile:
    try:
        fields = parser(content)
        contents = read_fields(fields, file)
    except UnreadableError as error:
        message = "The file is damaged, or not as OpenCV writes it."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error
    if contents is None:
        message, hint = other_keys(fields)
        raise InputError([Problem(CALIBRATION_EMPTY, message, file=file, hint=hint)])
    return contents


def read_fields(fields: Mapping[str, Any], file: str) -> CameraFile | None:
    """Read the cameras of a mapping; ``None`` if it has no camera of these formats.

    Raises ``InputError`` with all problems of all cameras.
    """
    if easymocap.is_rig(fields):
        return easymocap.read(fields, file)
    if camchain.is_rig(fields):
        return camchain.read(fields, file)
    listed = fields.get("cameras", fields)
    if isinstance(listed, list):
        listed = {_name(item, number): item for number, item in enumerate(listed) if is_camera(item)}
    if not isinstance(listed, dict):
        return None
    rig = {name: item for name, item in listed.items() if is_camera(item)}
    if not any(map(has_matrix, rig.values())):
        return None
    reading = Reading(file)
    reading.pass_over(fields, frozenset({"cameras", *rig}))
    # One camera above the limit suffices to report that there are too many.
    return _read_rig(dict(islice(rig.items(), MAX_CAMERAS + 1)), reading)


def _name(item: Mapping[str, Any], number: int) -> str:
    """Name of a camera of a list, else its number in the list."""
    return str(next((item[field] for field in _NAMES if isinstance(item.get(field), (str, int))), number))


def _read_rig(rig: Mapping[str, Mapping[str, Any]], reading: Reading) -> CameraFile:
    names = _own_names(rig)
    raw = [
        replace(read_camera(name, fields, reading), section=key if key != name else "")
        for (key, fields), name in zip(rig.items(), names, strict=True)
    ]
    if all(fields.keys() - size_names(fields) == _JARVIS for fields in rig.values()):
        return _in_millimetres(reading.contents("JARVIS", raw, None))
    is_4d = any(_4D_ASSOCIATION in fields for fields in rig.values())
    return reading.contents("4D Association JSON" if is_4d else "OpenCV", raw, None)


def _own_names(rig: Mapping[str, Mapping[str, Any]]) -> Sequence[str]:
    """Names of cameras: their fields ``name``, where these tell all cameras apart, else their keys."""
    names = [fields.get("name") or key for key, fields in rig.items()]
    return names if all(isinstance(name, str) for name in names) and len(set(names)) == len(rig) else list(rig)


def _in_millimetres(contents: CameraFile) -> CameraFile:
    """Contents in metres; files that other programs write for JARVIS may be in metres already."""
    if not contents.cameras or possible_units(contents.cameras) == ("m",):
        return contents
    cameras = tuple(scaled(camera, UNITS_M["mm"]) for camera in contents.cameras)
    return replace(contents, cameras=cameras, unit="mm")
