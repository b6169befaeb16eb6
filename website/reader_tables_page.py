"""Page ``docs/reference/reader-tables.md``: calibration and keypoint formats.

Its rows are written in the docstrings of the readers, the names of fields in their constants. The sources are parsed,
not imported: the web API knows no science.
"""

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

_PIPELINE = Path(__file__).parents[1] / "pipeline"
CALIBRATIONS = _PIPELINE / "calibration" / "readers"
"""Folder of the readers of calibration formats."""
KEYPOINTS = _PIPELINE / "capture" / "keypoint_files" / "readers"
"""Folder of the readers of keypoint formats."""

_FIELDS: Mapping[str, str] = {
    "_MATRIX": "camera matrix, 3 x 3",
    "_DISTORTION": "distortion coefficients",
    "_ROTATION": "rotation, a matrix or a Rodrigues vector",
    "_TRANSLATION": "translation",
    "_TRANSFORM": "rotation and translation, 3 x 4 or 4 x 4",
    "_LENS": "lens model, such as `fisheye`",
    "_FISHEYE": "fisheye lens, if it is true or 1",
}
"""Meanings of the fields that a constant of ``fields`` names."""

_INTRODUCTION = """\
# Calibration and keypoint formats

This page lists the calibration formats and the keypoint formats that Multicap reads. [Formats](formats.md) has the
rules that hold for all of them.

## Calibration formats

The column *lengths* has the unit of the format. For `units` you state the unit ([units](formats.md#units)). The column
*axes and names* says how the world is turned, and how cameras and videos are called.
"""
_FISHEYE_LENSES = """\
## Fisheye lenses

The lens is a fisheye lens of OpenCV's model `fisheye`, with 4 coefficients, if the camera has:

| format | field |
| --- | --- |
| Multicap | `"lens": "fisheye"` |
| anipose, Caliscope, FreeMoCap, Pose2Sim | `fisheye = true` |
| OpenCV FileStorage | `fisheye: 1`, or the lens model `fisheye`, `equidistant`, `kannala_brandt` or `opencv_fisheye` |
| Kalibr | `distortion_model: equidistant` |
| COLMAP | `OPENCV_FISHEYE`, `RADIAL_FISHEYE`, `SIMPLE_RADIAL_FISHEYE`, `FISHEYE` or `SIMPLE_FISHEYE` |

COLMAP's models `SIMPLE_PINHOLE`, `PINHOLE`, `SIMPLE_RADIAL`, `RADIAL`, `OPENCV` and `FULL_OPENCV` are read too.
"""
_EXAMPLES = """\
## Examples of calibrations

A camera maps a point of the world by `x = K (R X + t)`. Other cameras follow in the same way.

Multicap (`.json`):

```json
{"schema_version": 1,
 "cameras": [{"name": "left", "size_px": [1920, 1080],
              "matrix": [[1450.0, 0.0, 959.5], [0.0, 1450.0, 539.5], [0.0, 0.0, 1.0]],
              "distortion": [-0.1, 0.02, 0.0, 0.0, 0.0],
              "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
              "translation_m": [0.1, -0.2, 3.5]}]}
```

anipose, FreeMoCap, Pose2Sim (`.toml`). The name of the section counts without `name`; `rotation` is a Rodrigues vector:

```toml
[cam_0]
name = "left"
size = [1920, 1080]
matrix = [[1450.0, 0.0, 959.5], [0.0, 1450.0, 539.5], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.02, 0.0, 0.0, 0.0]
rotation = [1.2, 0.1, -0.3]
translation = [0.1, -0.2, 3.5]
```

OpenCV FileStorage (`.yml`). Anchors, aliases and repeated keys are refused:

```yaml
%YAML:1.0
---
left:
   image_width: 1920
   image_height: 1080
   camera_matrix: !!opencv-matrix
      rows: 3
      cols: 3
      dt: d
      data: [ 1450., 0., 959.5, 0., 1450., 539.5, 0., 0., 1. ]
   distortion_coefficients: [ -0.1, 0.02, 0., 0., 0. ]
   rvec: [ 1.2, 0.1, -0.3 ]
   tvec: [ 0.1, -0.2, 3.5 ]
```
"""
_NAMES = """\
## Names of fields

These names are read in files of OpenCV FileStorage, and in JSON without `schema_version`. The field `name` names the
cameras, if no two names are equal; else their keys do. Matrices are nested, or flat row after row. The size of the
picture is `image_width` and `image_height`, or a field such as `width`, `w`, `size`, `image_size`, `imgSize`,
`resolution` or `image_shape` (rows first).
"""
_KEYPOINTS = """\
## Keypoint formats

The column *files* says whether a file holds one frame or all frames. [The guide](../guide/keypoints.md) has the steps.
"""


def document() -> str:
    """Write the page as Markdown."""
    lines = [
        _INTRODUCTION,
        *_table("format", "file, recognised by", "lengths", "axes and names", folder=CALIBRATIONS),
        _FISHEYE_LENSES,
        _EXAMPLES,
        _NAMES,
        "| value | names |",
        "| --- | --- |",
        *_field_rows(),
        "",
        _KEYPOINTS,
        *_table("program", "files", "joints", "notes", folder=KEYPOINTS),
    ]
    return "\n".join(lines)


def _table(*heads: str, folder: Path) -> Iterator[str]:
    yield from (f"| {' | '.join(heads)} |", f"|{' --- |' * len(heads)}")
    rows = (row for path in folder.glob("*.py") for row in reader_rows(path))
    yield from sorted(rows, key=str.lower)
    yield ""


def reader_rows(path: Path) -> list[str]:
    """Rows of the table of formats in the docstring of a reader's module; each has four cells."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    table = text.partition("Rows of the table of formats:")[2]
    return re.findall(r"\|(?:[^|]*\|){4}", " ".join(table.split()))


def _field_rows() -> Iterator[str]:
    source = (CALIBRATIONS / "fields.py").read_text(encoding="utf-8")
    names = {
        statement.targets[0].id: ast.literal_eval(statement.value)
        for statement in ast.parse(source).body
        if isinstance(statement, ast.Assign)
        and isinstance(statement.targets[0], ast.Name)
        and statement.targets[0].id in _FIELDS
    }
    for constant, meaning in _FIELDS.items():
        yield f"| {meaning} | {', '.join(f'`{name}`' for name in names[constant])} |"
