"""Fields of a camera that no reader knows: which of them may hold the distortion, or the size of the picture.

The values tell, whatever the names: 4, 5, 8, 12 or 14 numbers with fractions may be a lens of OpenCV, two whole numbers
around the principal point a size. Names tell of other numbers: ``k1``, ``RadialDistortion``.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pipeline.core.parsing import SIDE_PX, UnreadableError, read_numbers

_LENS_LENGTHS = frozenset({4, 5, 8, 12, 14})
# Names of a single coefficient, and of several, whatever their number.
_COEFFICIENT = re.compile(r"(k|p|kappa|radial\w*|tangential\w*)_?\d+|(?!undist).*dist(ort|coef|_coef).*", re.IGNORECASE)
_COEFFICIENTS = re.compile(r"k|p|kc|(radial|tangential).*|.*(coe?ff?(s|ic)|(?<!un)dist(?!anc)).*", re.IGNORECASE)
# Names of lists that are no lens: how well something is known, whatever it is; and boxes, points, times, colours.
_STATISTICS = re.compile(
    "(?<![a-z])(err|rms|std|cov)|error|rmse|resid|reproj|sigma|deviat|std(?![a-z])|covar", re.IGNORECASE
)
_NO_LENS = re.compile(
    "box|roi(?![a-z])|(?<!cor)rect|crop|corner|point|time|stamp|colou?r|rgb|gain|white", re.IGNORECASE
)
_LENS_WORD = re.compile("lens|dist|coef", re.IGNORECASE)
_SIDE = re.compile(r"w|h|.*(width|height|cols|rows)", re.IGNORECASE)
_MIN_SIDE_PX = 16.0
_UNIT_TOLERANCE = 1e-3
_MAX_DEPTH = 4


def lens_fields(fields: Mapping[str, Any], known: frozenset[str], distortion: Any = None) -> Iterator[str]:
    """Names of fields that are not ``known`` and may hold the distortion; ``a.b`` is the field b of the field a.

    ``distortion`` is the distortion that is read: fields that repeat it don't count.
    """
    read = _numbers(distortion)
    for path, name, value in _leaves(fields, known):
        numbers = _numbers(value) if isinstance(value, list) else None
        if numbers is None:
            # A number, a text or a table under the name of a coefficient or of a distortion decides, too.
            is_lens = bool(value) and not isinstance(value, bool) and _COEFFICIENT.fullmatch(name) is not None
        elif numbers.size == max(numbers.shape):
            # Lists of whole numbers are indices, pixels or counts.
            is_like_lens = numbers.size in _LENS_LENGTHS and bool((numbers != np.round(numbers)).any())
            is_lens = is_like_lens or _COEFFICIENTS.fullmatch(name) is not None
        else:
            is_lens = _COEFFICIENT.fullmatch(name) is not None
        if is_lens and (numbers is None or not _is_other(name, numbers.ravel(), read)):
            yield path


def size_fields(fields: Mapping[str, Any], known: frozenset[str], matrix: Any) -> Iterator[str]:
    """Names of fields that are not ``known`` and may hold the size of the picture, or a side of it.

    ``matrix`` is the camera matrix: its principal point is near the middle of the picture.
    """
    camera_matrix = _numbers(matrix)
    if camera_matrix is None or camera_matrix.shape != (3, 3):
        return
    focal_px, point_px = camera_matrix.diagonal()[:2], camera_matrix[:2, 2]

    def is_size(sides_px: np.ndarray, middle_px: np.ndarray) -> bool:
        return bool((np.abs(2 * middle_px - sides_px) < sides_px / 2).all())

    for path, name, value in _leaves(fields, known):
        sides_px = _numbers(value)
        if (
            sides_px is None
            or sides_px.size > 2
            or not SIDE_PX.holds(sides_px)
            or (sides_px != np.round(sides_px)).any()
        ):
            continue
        sides_px = sides_px.ravel()
        if sides_px.min() < _MIN_SIDE_PX or any(np.array_equal(sides_px, pair) for pair in (focal_px, point_px)):
            continue
        is_pair = sides_px.size == 2 and (is_size(sides_px, point_px) or is_size(sides_px[::-1], point_px))
        is_side = sides_px.size == 1 and _SIDE.fullmatch(name) and any(is_size(sides_px, middle) for middle in point_px)
        if is_pair or is_side:
            yield path


def _leaves(fields: Mapping[str, Any], known: frozenset[str], depth: int = 0) -> Iterator[tuple[str, str, Any]]:
    """Path, name and value of the fields that are not known, and of the fields inside them."""
    for name, value in fields.items():
        if name in known:
            continue
        if isinstance(value, dict) and value and depth < _MAX_DEPTH and not _COEFFICIENT.fullmatch(name):
            for path, inner, leaf in _leaves(value, frozenset(), depth + 1):
                yield f"{name}.{path}", inner, leaf
        else:
            yield name, name, value


def _numbers(value: Any) -> np.ndarray | None:
    """Array of a number or of nested lists; ``None`` for other values, and for lists without a number."""
    try:
        numbers = read_numbers(value)
    except UnreadableError:
        return None
    return None if np.isnan(numbers).all() else numbers


def _is_other(name: str, numbers: np.ndarray, read: np.ndarray | None) -> bool:
    """Return whether a list is no distortion, or one without an effect."""
    if not numbers.any() or _STATISTICS.search(name) or (_NO_LENS.search(name) and not _LENS_WORD.search(name)):
        return True
    if read is not None and np.array_equal(numbers, read.ravel()):
        return True
    # A quaternion, a plane, or the last row of a transform or of a projection.
    directions = {4: (numbers, numbers[:3]), 12: (numbers[8:11],)}.get(numbers.size, ())
    return any(
        np.abs(direction).max() < 1.0 + _UNIT_TOLERANCE and abs(np.linalg.norm(direction) - 1.0) < _UNIT_TOLERANCE
        for direction in directions
    )
