"""Files that can't be read as a calibration: what they hold, decimal commas among others, and what to do."""

import re
from collections.abc import Iterable, Mapping
from pathlib import PurePath

from pipeline.core.errors import listed_names

SUPPORTED = (
    "Use Qualisys QCA, Vicon XCP, OptiTrack MCAL, TOML (Caliscope, anipose, Pose2Sim, FreeMoCap), JSON, OpenCV's YAML "
    "or XML, EasyMocap, JARVIS, OpenPose, 4D Association, COLMAP, CMU Panoptic, Human3.6M, VoxelPose, MVPose, OpenCap, "
    "Kalibr, MAMMA or bioCV."
)

_AS_OPENCV = (
    "Write camera matrix, distortion, rotation, translation and size of each camera as OpenCV's YAML or as JSON; "
    "`multicap help reader-tables` has the names of fields."
)
_COLMAP = "Convert it by `colmap model_converter --output_type TXT`, and send a zip of cameras.txt and images.txt."
# Files of other formats by their endings: what they are, and what to do.
_OTHERS: Mapping[str, tuple[str, str]] = {
    ".cal": ("a calibration of Motive before 3.2", "Open it in a newer Motive, and export it as .mcal."),
    ".bin": ("a binary model, like COLMAP's", _COLMAP),
    ".db": ("a database, like COLMAP's", _COLMAP),
    ".mat": ("a file of MATLAB", _AS_OPENCV),
    ".npz": ("a file of NumPy", _AS_OPENCV),
    ".npy": ("a file of NumPy", _AS_OPENCV),
    ".h5": ("an HDF5 file", _AS_OPENCV),
    ".csv": ("a table", _AS_OPENCV),
    ".txt": ("a text", "From COLMAP, send a zip of cameras.txt and images.txt."),
    ".c3d": ("a file of markers", "Export the calibration of the cameras from the same program."),
    ".qtm": ("a measurement of Qualisys", "Export its calibration: File, Export, or the .qca.txt of the calibration."),
    ".x2d": ("a capture of Vicon", "Send the .xcp file beside it."),
}


def other_format(name: str) -> tuple[str, str]:
    """Message and hint for a file whose format is not read."""
    what, hint = _OTHERS.get(PurePath(name).suffix.lower(), ("", ""))
    if not what:
        return "The format of the calibration file is not supported.", SUPPORTED
    return f"The file is {what}, which is not read as a calibration.", hint


def other_members(names: Iterable[str]) -> tuple[str, str]:
    """Message and hint for an archive without a file that is read."""
    names = list(names)
    hints = [_OTHERS[suffix][1] for name in names if (suffix := PurePath(name).suffix.lower()) in _OTHERS]
    files = "a file of OpenCV, JARVIS, OpenPose, OpenCap or bioCV for each camera"
    pack = f"Pack intri.yml and extri.yml, cameras.txt and images.txt, or {files}."
    content = listed_names(names) if names else "no file"
    return f"The archive has {content}, and no calibration of a supported format.", hints[0] if hints else pack


def other_keys(keys: Iterable[object]) -> tuple[str, str]:
    """Message and hint for a file with other values than cameras."""
    keys = list(keys)
    content = f"the keys {listed_names(keys)}" if keys else "no keys"
    return f"The file has {content}, and no camera: a camera matrix, with a rotation and a translation.", SUPPORTED


# Between the items of a list a comma is followed neither by a zero with more digits nor by so many digits.
_WITH_COMMA = re.compile(rb"-?\d+,(?:0\d|\d{6})\d*")
_WITH_POINT, _ANY_COMMA = re.compile(rb"\d\.\d"), re.compile(rb"(?<=\d),(?=\d)")

COMMA_HINT = "Write decimal points."


def comma_in(content: bytes) -> str | None:
    """First number with a decimal comma, in text with more of these than of points; ``None`` otherwise.

    Versions of programs and of formats have points in files of any language.
    """
    found = _WITH_COMMA.findall(content)
    return found[0].decode() if len(found) > len(_WITH_POINT.findall(content)) else None


def comma_message(comma: str) -> str:
    """Message of the problem of a file whose decimal commas can't be read."""
    return f"The numbers have decimal commas, such as {comma}, which can't be told from the commas between numbers."


def with_points(content: bytes) -> bytes:
    """Text in which numbers with decimal commas have points; spaces, quotes or tags separate the numbers."""
    return _ANY_COMMA.sub(b".", content)
