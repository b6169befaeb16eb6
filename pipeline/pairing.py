"""Which video, or which folder of keypoints, belongs to which camera."""

from collections.abc import Sequence

from pipeline.errors import Problem


def pair_by_name(
    cameras: Sequence[str], names: Sequence[str], thing: str
) -> tuple[dict[str, str], list[Problem], list[str]]:
    """Pair cameras and things by exact name, all of them, or in sorted order, all of them; never half by half.

    Parameters
    ----------
    cameras
        The cameras' names.
    names
        Those of the things, without endings.
    thing
        What they are, such as ``video``; part of the problems' codes.

    Returns
    -------
    pairs
        Name of the thing of each camera.
    problems
        Cameras and things that are left over.
    warnings
        The pairs, where they were paired in sorted order.
    """
    if not set(cameras) & set(names) and len(cameras) == len(names):
        pairs = dict(zip(sorted(cameras), sorted(names), strict=True))
        shown = ", ".join(f"{camera}: {name}" for camera, name in pairs.items())
        return pairs, [], [f"No {thing} bears the name of a camera. They were paired in sorted order: {shown}."]
    problems = [
        Problem(
            f"camera_without_{thing}",
            f"The calibration has this camera, but no {thing} bears its name.",
            camera=camera,
            hint=f"Add its {thing}, or remove it from the calibration.",
        )
        for camera in sorted(set(cameras) - set(names))
    ]
    problems += [
        Problem(
            f"{thing}_without_camera",
            f"No camera in the calibration has the name of this {thing}.",
            file=name,
            hint=f"The calibration's cameras are {', '.join(sorted(cameras))}.",
        )
        for name in sorted(set(names) - set(cameras))
    ]
    return {camera: camera for camera in cameras if camera in names}, problems, []
