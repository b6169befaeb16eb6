"""Checks of a calibration from people: what refuses it, and what to film again."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pipeline.calibration.people.pairs import Relative
from pipeline.calibration.people.tracklets import Tracklet
from pipeline.calibration.people.world import PeopleWorld
from pipeline.calibration.report import CameraReport
from pipeline.data import Camera
from pipeline.errors import InputError, Problem

_FILM = "Let one or two people walk about for a minute where several cameras see them whole."
_MIN_INSTANTS, _FEW_INSTANTS = 50, 150
# Standard deviations above which a calibration is doubtful.
_MAX_FOCAL_PERCENT, _MAX_ROTATION_DEG = 2.0, 0.3


def require_people(cameras: Sequence[Camera], tracklets: Sequence[Tracklet]) -> None:
    """Raise ``InputError`` if there is one camera only, or with all cameras that see people too briefly."""
    if len(cameras) < 2:
        message = "People calibrate two cameras or more."
        raise InputError([Problem("people_one_camera", message, hint="For one camera, film a board.")])
    problems = []
    for number, camera in enumerate(cameras):
        seen = sum(len(one.points_px) for one in tracklets if one.camera == number)
        if seen < _MIN_INSTANTS:
            message = f"The camera sees people for {seen / 10:.1f} s; at least {_MIN_INSTANTS / 10:.0f} s are required."
            problems.append(Problem("people_not_found", message, camera=camera.name, hint=_FILM))
    if problems:
        raise InputError(problems)


def linked_or_refused(
    cameras: Sequence[Camera], posed: Mapping[int, Camera], relatives: Sequence[Relative]
) -> list[Camera]:
    """All cameras with their poses.

    Raises
    ------
    InputError
        If a camera is not linked.
    """
    problems = []
    for number, camera in enumerate(cameras):
        if number in posed:
            continue
        own = [one for one in relatives if number in (one.first, one.second)]
        if own:
            message = "What the camera sees of the people disagrees with the other cameras."
            hint = "Check that the videos are synchronised, that no camera moved, and that the intrinsics are its own."
            problems.append(Problem("people_disagree", message, camera=camera.name, hint=hint))
        else:
            message = "The camera sees nobody at the same time as another camera, or can't be told to."
            problems.append(Problem("people_unlinked", message, camera=camera.name, hint=_FILM))
    if problems:
        raise InputError(problems)
    return [posed[number] for number in range(len(cameras))]


def world_or_refused(world: PeopleWorld | None) -> PeopleWorld:
    """World.

    Raises
    ------
    InputError
        If there is none.
    """
    if world is None:
        message = "Nobody is seen from the shoulders to the ankles for a second; scale and vertical are unknown."
        raise InputError([Problem("people_not_whole", message, hint=_FILM)])
    return world


def people_warnings(reports: Sequence[CameraReport], world: PeopleWorld) -> Iterator[Problem]:
    """Doubts about cameras, their focal lengths and the floor."""
    for one in reports:
        if one.num_views < _FEW_INSTANTS:
            message = f"The camera shares people with another camera for {one.num_views / 10:.1f} s."
            yield Problem("people_few_views", message, camera=one.name, hint=_FILM)
        if one.rotation_sigma_deg > _MAX_ROTATION_DEG:
            message = f"The camera's rotation is known to {one.rotation_sigma_deg:.1f} degrees."
            yield Problem("people_uncertain_pose", message, camera=one.name, hint=_FILM)
        if np.isfinite(one.focal_sigma_percent) and one.focal_sigma_percent > _MAX_FOCAL_PERCENT:
            message = f"The focal length is known to {one.focal_sigma_percent:.1f} %."
            hint = "Give the intrinsics, or calibrate them from a board."
            yield Problem("people_uncertain_focal", message, camera=one.name, hint=hint)
    if not world.has_floor:
        message = "The feet reach too little ground to find its slope; the vertical is that of upright standing."
        yield Problem("people_uncertain_floor", message, hint="Let the people walk all over the place.")
