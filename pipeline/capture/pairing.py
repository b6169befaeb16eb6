"""Which video, or which folder of keypoints, belongs to which camera."""

from collections.abc import Sequence

from pipeline.data import Camera
from pipeline.errors import Problem


def pair_by_name(
    cameras: Sequence[Camera], names: Sequence[str], thing: str
) -> tuple[dict[str, str], list[Problem], list[str]]:
    """Pair cameras and things by exact name, all of them, or in sorted order, all of them; never half by half.

    Parameters
    ----------
    cameras
        A thing may bear the name of a camera, or that of its section in the calibration.
    names
        Those of the things, without endings.
    thing
        What they are, such as ``video``; part of the problems' codes.

    Returns
    -------
    pairs
        Name of the thing of each camera, by the camera's name.
    problems
        Cameras and things that are left over, and things of which two are one camera's.
    warnings
        The pairs, where they were paired in sorted order.
    """
    known = {camera.section: camera.name for camera in cameras} | {camera.name: camera.name for camera in cameras}
    called = [camera.name for camera in cameras]
    if not known.keys() & set(names) and len(called) == len(names):
        pairs = dict(zip(sorted(called), sorted(names), strict=True))
        shown = ", ".join(f"{camera}: {name}" for camera, name in pairs.items())
        return pairs, [], [f"No {thing} bears the name of a camera. They were paired in sorted order: {shown}."]
    pairs = {}
    problems: list[Problem] = []
    for name in sorted(set(names)):
        camera = known.get(name)
        if camera is None:
            problems.append(
                Problem(
                    f"{thing}_without_camera",
                    f"No camera in the calibration has the name of this {thing}.",
                    file=name,
                    hint=f"The calibration's cameras are {', '.join(sorted(called))}.",
                )
            )
        elif camera in pairs:
            problems.append(
                Problem(
                    f"{thing}_doubled",
                    f"This {thing} and {pairs[camera]} are of one camera.",
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
            f"The calibration has this camera, but no {thing} bears its name.",
            camera=camera,
            hint=f"Add its {thing}, or remove it from the calibration.",
        )
        for camera in sorted(set(called) - pairs.keys())
    ] + problems
    return pairs, problems, []
