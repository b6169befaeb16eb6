"""Pair cameras with videos, or with folders of keypoints."""

from collections.abc import Sequence

from pipeline.data import Camera
from pipeline.errors import Problem


def pair_by_name(
    cameras: Sequence[Camera], names: Sequence[str], thing: str
) -> tuple[dict[str, str], list[Problem], list[str]]:
    """Pair cameras and inputs, either all by exact name or all in sorted order.

    Parameters
    ----------
    cameras
        Cameras. An input may have the name of a camera, or of the camera's section in the calibration.
    names
        Names of the inputs without endings.
    thing
        Kind of input, such as ``video``; part of the problem codes.

    Returns
    -------
    pairs
        Name of the input of each camera, by camera name.
    problems
        Cameras without input, inputs without camera, and second inputs of a camera.
    warnings
        List of the pairs, if they were paired in sorted order.
    """
    known = {camera.section: camera.name for camera in cameras} | {camera.name: camera.name for camera in cameras}
    called = [camera.name for camera in cameras]
    if not known.keys() & set(names) and len(called) == len(names):
        pairs = dict(zip(sorted(called), sorted(names), strict=True))
        shown = ", ".join(f"{camera}: {name}" for camera, name in pairs.items())
        return pairs, [], [f"No {thing} has the name of a camera. They were paired in sorted order: {shown}."]
    pairs = {}
    problems: list[Problem] = []
    for name in sorted(set(names)):
        camera = known.get(name)
        if camera is None:
            problems.append(
                Problem(
                    f"{thing}_without_camera",
                    f"The calibration has no camera with the name of this {thing}.",
                    file=name,
                    hint=f"The calibration's cameras are {', '.join(sorted(called))}.",
                )
            )
        elif camera in pairs:
            problems.append(
                Problem(
                    f"camera_with_two_{thing}s",
                    f"This {thing} and {pairs[camera]} belong to the same camera.",
                    file=name,
                    camera=camera,
                    hint="Remove one of them.",
                )
            )
        else:
            pairs[camera] = name
    problems = [
        Problem(
            f"camera_without_{thing}",
            f"The calibration has this camera, but no {thing} has its name.",
            camera=camera,
            hint=f"Add its {thing}, or remove it from the calibration.",
        )
        for camera in sorted(set(called) - pairs.keys())
    ] + problems
    return pairs, problems, []
