"""Checks of a calibration from people: what refuses it, and what to film again."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.calibration.people.pairs import RelativePose
from pipeline.calibration.people.people_world import PeopleWorld
from pipeline.calibration.people.tracklets import ViewTracklet
from pipeline.calibration.report import CameraReport
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems import finding_codes, session_codes
from pipeline.geometry.camera import center_in_world

_FILM = "Let one or two people walk about for a minute where several cameras see them whole."
_CHECK = "Check that the videos are synchronised, that no camera moved, and that the intrinsics are its own."
_MIN_INSTANTS, _FEW_INSTANTS = 50, 150
# Standard deviations above which a calibration is doubtful.
_MAX_FOCAL_PERCENT, _MAX_ROTATION_DEG = 2.0, 0.3
# Ratio of a camera's reprojection error to the median of all above which it is doubtful.
_POOR_FIT = 1.4
# Share of the observations that fit, over the median camera's share, below which a camera may have taken one person for
# another one, and stand elsewhere.
_MIN_FITTING = 0.9
# Logarithm of the ratio of a person's stature to the stated one above which it is another person's: the segments of
# people of one stature differ by a few percent.
_STATURE_RATIO = 0.08
# Cameras that are closer than this share of the mean distance of two cameras may have the same video.
_SAME_PLACE = 0.03


def require_people(cameras: Sequence[Camera], tracklets: Sequence[ViewTracklet], rate_hz: float) -> None:
    """Raise ``InputError`` if there is one camera only, or with all cameras that see people too briefly."""
    if len(cameras) < 2:
        message = "People calibrate two cameras or more."
        raise InputError([Problem(session_codes.PEOPLE_ONE_CAMERA, message, hint="For one camera, film a board.")])
    problems = []
    for number, camera in enumerate(cameras):
        seen = sum(len(tracklet.points_px) for tracklet in tracklets if tracklet.camera == number)
        if seen < _MIN_INSTANTS:
            least_s = _MIN_INSTANTS / rate_hz
            message = f"The camera sees people for {seen / rate_hz:.1f} s; at least {least_s:.0f} s are required."
            problems.append(Problem(session_codes.PEOPLE_NOT_FOUND, message, camera=camera.name, hint=_FILM))
    if problems:
        raise InputError(problems)


def require_linked_by_people(
    cameras: Sequence[Camera], posed: Mapping[int, Camera], relatives: Sequence[RelativePose]
) -> list[Camera]:
    """All cameras with their poses. Raises ``InputError`` if a camera is not linked."""
    problems = []
    for number, camera in enumerate(cameras):
        if number in posed:
            continue
        own = [pose for pose in relatives if number in (pose.first, pose.second)]
        if own:
            message = "The people in this camera disagree with the other cameras."
            problems.append(Problem(session_codes.PEOPLE_DISAGREE, message, camera=camera.name, hint=_CHECK))
        else:
            message = "The camera never sees a person together with another camera, or this is uncertain."
            problems.append(Problem(session_codes.PEOPLE_UNLINKED, message, camera=camera.name, hint=_FILM))
    if problems:
        raise InputError(problems)
    return [posed[number] for number in range(len(cameras))]


def world_or_refused(world: PeopleWorld | None) -> PeopleWorld:
    """World. Raises ``InputError`` if there is none."""
    if world is None:
        message = "No person is seen from shoulders to ankles for a second. Scale and vertical are unknown."
        raise InputError([Problem(session_codes.PEOPLE_NOT_WHOLE, message, hint=_FILM)])
    return world


def people_warnings(
    reports: Sequence[CameraReport],
    fitting: Float[np.ndarray, " cameras"],
    world: PeopleWorld,
    stature_m: Sequence[float],
    rate_hz: float,
) -> Iterator[Problem]:
    """Doubts about cameras, their focal lengths, the statures and the floor."""
    yield from _same_places(world.cameras)
    if len(stature_m) > 1:
        yield from _other_statures(world, stature_m)
    median_px = float(np.nanmedian([report.reprojection_error_px for report in reports]))
    for report, share in zip(reports, fitting.tolist(), strict=True):
        if share < _MIN_FITTING * float(np.median(fitting)):
            message = (
                f"{100 * share:.0f} % of the people's joints in this camera fit the other cameras; usual are "
                f"{100 * np.median(fitting):.0f} %. The camera may stand elsewhere."
            )
            yield Problem(finding_codes.PEOPLE_POOR_FIT, message, camera=report.name, hint=f"{_CHECK} Or film longer.")
        if report.reprojection_error_px > _POOR_FIT * median_px:
            message = (
                f"The reprojection error, {report.reprojection_error_px:.1f} px, is larger than the error of the other "
                f"cameras ({median_px:.1f} px)."
            )
            yield Problem(finding_codes.PEOPLE_POOR_FIT, message, camera=report.name, hint=_CHECK)
        if report.num_views < _FEW_INSTANTS:
            message = f"The camera shares people with another camera for {report.num_views / rate_hz:.1f} s."
            yield Problem(finding_codes.PEOPLE_FEW_VIEWS, message, camera=report.name, hint=_FILM)
        if report.rotation_sigma_deg > _MAX_ROTATION_DEG:
            message = (
                f"The camera's rotation is known to {report.rotation_sigma_deg:.1f} degrees and its position to "
                f"{report.position_sigma_mm:.0f} mm."
            )
            yield Problem(finding_codes.PEOPLE_UNCERTAIN_POSE, message, camera=report.name, hint=_FILM)
        if np.isfinite(report.focal_sigma_percent) and report.focal_sigma_percent > _MAX_FOCAL_PERCENT:
            message = f"The focal length is known to {report.focal_sigma_percent:.1f} %."
            hint = "Give the intrinsics, or calibrate them from a board."
            yield Problem(finding_codes.PEOPLE_UNCERTAIN_FOCAL, message, camera=report.name, hint=hint)
    if not world.has_floor:
        message = "The feet reach too little ground to find its slope; the vertical comes from upright standing."
        yield Problem(finding_codes.PEOPLE_UNCERTAIN_FLOOR, message, hint="Let the people walk all over the place.")


def _other_statures(world: PeopleWorld, stature_m: Sequence[float]) -> Iterator[Problem]:
    hint = "State the stature of each person, or one for all."
    given = ", ".join(f"{height_m:.2f}" for height_m in stature_m)
    if -1 in world.statures:
        message = f"More people are seen at once than statures are given ({given} m)."
        yield Problem(finding_codes.PEOPLE_STATURES, message, field="stature_m", hint=hint)
    if unused := [f"{stature_m[number]:.2f}" for number in range(len(stature_m)) if number not in world.statures]:
        message = f"Of the statures {given} m, no person has {', '.join(unused)} m: fewer people are seen whole."
        yield Problem(finding_codes.PEOPLE_STATURES, message, field="stature_m", hint=hint)
    pairs = [
        (own_m, stature_m[number])
        for own_m, number in zip(world.estimates_m, world.statures, strict=True)
        if number >= 0
    ]
    if worst := max(pairs, key=lambda pair: abs(np.log(pair[0] / pair[1])), default=None):
        own_m, known_m = worst
        if abs(np.log(own_m / known_m)) > _STATURE_RATIO:
            message = (
                f"The ratios of the statures {given} m do not fit the people: the person of {known_m:.2f} m is "
                f"{own_m:.2f} m tall at the scale that fits most."
            )
            yield Problem(finding_codes.PEOPLE_STATURES, message, field="stature_m", hint=hint)


def _same_places(cameras: Sequence[Camera]) -> Iterator[Problem]:
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    apart_m = np.linalg.norm(centers_m[:, None] - centers_m[None], axis=-1)
    limit_m = _SAME_PLACE * apart_m.sum() / (len(cameras) * (len(cameras) - 1))
    for number, neighbour in zip(*np.nonzero(np.tril(apart_m < limit_m, -1)), strict=True):
        message = f"The camera is at nearly the same place as {cameras[neighbour].name}."
        hint = "Check whether one video was given twice."
        yield Problem(finding_codes.PEOPLE_SAME_PLACE, message, camera=cameras[number].name, hint=hint)
