"""Checks of known points before anything is calibrated. Standard library only: the web API runs them too."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from math import dist, hypot

from pipeline.core.errors import Problem
from pipeline.core.options.job_choices import KnownPoint
from pipeline.core.problems import session_codes

MIN_POINTS = 3
MIN_POINTS_OF_CAMERA = {True: 4, False: 6}
"""Fewest points of a scene that place a camera: of a known lens, and of an unknown one."""
# Points are on a line if no triangle of them is higher than this share of its longest side.
_MIN_HEIGHT_SHARE = 0.05

Size = tuple[int, int]


def point_problems(points: Sequence[KnownPoint], sizes_px: Mapping[str, Size]) -> list[Problem]:
    """Find everything that is wrong with known points, given the size of each camera's pictures."""
    problems = [*_repeated(points), *_misplaced(points, sizes_px)]
    seen = [point for point in points if sum(camera in sizes_px for camera, _, _ in point.seen_px) > 1]
    if len(seen) < MIN_POINTS:
        message = f"{len(seen)} points are seen by two cameras; at least {MIN_POINTS} are required."
        alone = sorted(point.name for point in points if point not in seen)
        hint = "Mark each point in the pictures of two cameras or more, under the same name."
        if alone:
            hint = f"{hint} Seen by one camera: {', '.join(alone[:10])}."
        problems.append(Problem(session_codes.KNOWN_POINTS_FEW, message, field="known_points", hint=hint))
    elif _are_on_a_line(seen):
        message = "The points that two cameras see are on a line, about which the world could turn."
        problems.append(
            Problem(session_codes.KNOWN_POINTS_ON_A_LINE, message, field="known_points", hint="Add a point beside it.")
        )
    return problems


def scene_problems(points: Sequence[KnownPoint], sizes_px: Mapping[str, Size], has_intrinsics: bool) -> list[Problem]:
    """Find everything that is wrong with points that shall place each camera by itself."""
    problems = [*_repeated(points), *_misplaced(points, sizes_px)]
    if not sizes_px:
        hint = "Mark points in a picture of each camera."
        problems.append(
            Problem(session_codes.KNOWN_POINTS_FEW, "No camera sees a point.", field="known_points", hint=hint)
        )
    least = MIN_POINTS_OF_CAMERA[has_intrinsics]
    lens = "" if has_intrinsics else " while its lens is not known"
    for camera in sizes_px:
        seen = [point for point in points if any(name == camera for name, _, _ in point.seen_px)]
        if len(seen) < least:
            message = f"{len(seen)} points are marked; the camera needs {least}{lens}."
            hint = "Mark more points, far apart in the picture and not all in one plane."
            problems.append(Problem(session_codes.KNOWN_POINTS_FEW, message, None, camera, "known_points", hint))
        elif _are_on_a_line(seen):
            message = "The points are on a line, about which the camera could turn."
            hint, code = "Add a point beside it.", session_codes.KNOWN_POINTS_ON_A_LINE
            problems.append(Problem(code, message, None, camera, "known_points", hint))
    return problems


def _repeated(points: Sequence[KnownPoint]) -> Iterator[Problem]:
    for name, times in Counter(point.name for point in points).items():
        if times > 1:
            yield _invalid(f"{times} points are named {name}.", "Give each point a name of its own.")
    for point in points:
        for camera, times in Counter(camera for camera, _, _ in point.seen_px).items():
            if times > 1:
                yield _invalid(f"The point {point.name} has {times} places in the picture.", "State one.", camera)


def _misplaced(points: Sequence[KnownPoint], sizes_px: Mapping[str, Size]) -> Iterator[Problem]:
    unknown = {
        camera: point.name for point in reversed(points) for camera, _, _ in point.seen_px if camera not in sizes_px
    }
    for camera, name in unknown.items():
        hint = f"The cameras are {', '.join(sizes_px)}."
        yield Problem(
            session_codes.CAMERA_UNKNOWN,
            f"There is no camera of this name, in which the point {name} is seen.",
            camera=camera,
            field="known_points",
            hint=hint,
        )
    for point in points:
        for camera, x_px, y_px in point.seen_px:
            width, height = sizes_px.get(camera, (0, 0))
            if camera in sizes_px and not (-0.5 <= x_px <= width - 0.5 and -0.5 <= y_px <= height - 0.5):
                message = (
                    f"The point {point.name} at {x_px:g}, {y_px:g} is not in the picture of {width} x {height} pixels."
                )
                yield _invalid(message, "State pixels of the full picture, from its top left corner.", camera)


def _are_on_a_line(points: Sequence[KnownPoint]) -> bool:
    longest_m, first, second = max(
        ((dist(start.xyz_m, end.xyz_m), start, end) for start, end in combinations(points, 2)),
        key=lambda pair: pair[0],
    )
    if longest_m == 0.0:
        return True
    along = [(b - a) / longest_m for a, b in zip(first.xyz_m, second.xyz_m, strict=True)]

    def height_m(point: KnownPoint) -> float:
        from_first = [b - a for a, b in zip(first.xyz_m, point.xyz_m, strict=True)]
        share_m = sum(a * b for a, b in zip(along, from_first, strict=True))
        return hypot(*(b - share_m * a for a, b in zip(along, from_first, strict=True)))

    return max(map(height_m, points)) < _MIN_HEIGHT_SHARE * longest_m


def _invalid(message: str, hint: str, camera: str | None = None) -> Problem:
    return Problem(session_codes.KNOWN_POINTS_INVALID, message, camera=camera, field="known_points", hint=hint)
