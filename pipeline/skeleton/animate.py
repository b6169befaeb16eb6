"""Motion of all people: smoothing or skeleton fit, standing feet held in place, and hands."""

from collections.abc import Sequence
from typing import Literal

from pipeline.config import ReconstructionConfig
from pipeline.data.animation import Animation, Floor, SkeletonMotion
from pipeline.data.cameras import Camera, Timebase
from pipeline.data.people import Observations, Track3D
from pipeline.joints import FINGER_JOINTS, MARKED_AT_CENTERS, JointOffsets, JointSet, without_hands
from pipeline.progress import OnShare, ignore, split
from pipeline.rules import cutoff_problems, require
from pipeline.skeleton.feet.floor import shared_floor
from pipeline.skeleton.feet.stances import contacts_of, foot_points, hold_feet
from pipeline.skeleton.fitting.fit import SkeletonFit, fit_to_rays, follow
from pipeline.skeleton.hands.whole import (
    fit_hands,
    follow_hands,
    has_fingers,
    selected,
    unseen,
    views_of_hands,
    with_fingers,
    with_hands,
)
from pipeline.skeleton.smooth import smooth_track

# Shares of the computing time: positions, skeleton motion, holding feet, positions from the motion.
_WORK = (6, 6, 3, 1)


def animate(
    tracks: Sequence[Track3D],
    observations: Sequence[Observations],
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
    on_share: OnShare = ignore,
    offsets: JointOffsets = MARKED_AT_CENTERS,
    floor: Floor | Literal["estimated"] | None = "estimated",
    on_floor: Sequence[int] | None = None,
) -> Animation:
    """Compute the skeleton motion and the final joint positions of all people.

    Parameters
    ----------
    tracks
        Tracks with the joints located by association.
    observations
        Observations of the tracks, in the same order. Each is asked for twice, and only those of one person are kept at
        a time: they may be read from a file.
    config
        Method of smoothing, and treatment of feet. With ``fit``, the final joint positions are those of the skeleton.
        Otherwise each joint is smoothed by itself, and the skeleton follows the joints.
    offsets
        Offsets of the detector's marks from the joints' centres. Only the fit can move joints to their centres.
    floor
        Floor under the people; ``None``: there is none; ``estimated``: it is estimated from their feet.
    on_floor
        Positions of the people from whose feet the floor is estimated; ``None``: all.

    Raises
    ------
    InputError
        If the cutoff of the low-pass is not below half of the frame rate.
    """
    require(cutoff_problems(config.smoothing, config.cutoff_hz, timebase.frame_rate_hz))
    num_frames = [track.num_frames for track in tracks]
    work = [share * num for shares in (_WORK[:2], _WORK[2:]) for num in num_frames for share in shares]
    parts = iter(split(on_share, work))
    body = without_hands(joints)
    fits: list[SkeletonFit] = []
    motions: list[SkeletonMotion] = []

    # Observations are local to calls, so that none outlives the work on its person.
    def start(track: Track3D, seen: Observations) -> None:
        of_body = selected(track, seen, joints, body.names)
        fitted = _prepare(*of_body, cameras, timebase, body, config, offsets, next(parts))
        motions.append(fitted.motion(next(parts)))
        fitted.drop_observations()
        fits.append(fitted)

    def finish(number: int, track: Track3D, seen: Observations, floor: Floor | None) -> Track3D:
        fitted = fits[number]
        _, body_seen = selected(track, seen, joints, body.names)
        fitted.take_observations(body_seen, cameras)
        contacts = contacts_of(points[number], floor, timebase.frame_rate_hz, config.feet)
        motions[number] = hold_feet(fitted, motions[number], points[number], contacts, floor, next(parts))
        on_followed = next(parts)
        followed = fitted.track
        if config.smoothing == "fit":
            followed = follow(fitted, motions[number], body_seen, cameras, on_followed)
        if has_fingers(joints):
            motions[number], followed = _add_hands(
                motions[number], followed, track, seen, cameras, timebase, joints, config, fitted.has_torso
            )
        fitted.drop_observations()
        return followed

    for number in range(len(tracks)):
        start(tracks[number], observations[number])
    points = [foot_points(fitted, motion, body) for fitted, motion in zip(fits, motions, strict=True)]
    if floor == "estimated":
        judged = points if on_floor is None else [points[number] for number in on_floor]
        floor = shared_floor(
            [person.ankles_m for person in judged],
            [person.ankles_known for person in judged],
            [person.support.carries for person in judged],
            timebase.frame_rate_hz,
        )
    finals = [finish(number, tracks[number], observations[number], floor) for number in range(len(tracks))]
    on_share(1.0)
    return Animation(tuple(finals), tuple(motions), floor)


def _add_hands(
    motion: SkeletonMotion,
    followed: Track3D,
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
    is_placed: bool,
) -> tuple[SkeletonMotion, Track3D]:
    """Fit the hands of a person on the fitted body, and add their joints to the motion and to the track.

    Parameters
    ----------
    motion, followed
        Motion and final joints of the body.
    track, seen
        Located joints with their observations, fingers included.
    is_placed
        True if the body's position is known; otherwise hands are in the natural pose, and fingers stay where they are.
    """
    by_rays = config.smoothing == "fit"
    start = track if by_rays else smooth_track(track, seen, cameras, timebase, config)
    views = views_of_hands(start, seen, joints, timebase.frame_rate_hz)
    if not is_placed:
        views = {side: unseen(view) for side, view in views.items()}
    hands = fit_hands(motion, start, views, joints, cameras if by_rays else None)
    if by_rays and is_placed:
        fingers = follow_hands(followed, motion, hands, track, seen, joints, cameras)
    else:
        fingers, _ = selected(start, seen, joints, [name for name in joints.names if name in FINGER_JOINTS])
    return with_hands(motion, hands), with_fingers(followed, fingers, joints)


def _prepare(
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
    offsets: JointOffsets,
    on_share: OnShare,
) -> SkeletonFit:
    name = f"person-{track.track_id}"
    if config.smoothing == "fit":
        return fit_to_rays(track, seen, cameras, timebase, joints, name, offsets, on_share)
    return SkeletonFit(smooth_track(track, seen, cameras, timebase, config), joints, timebase, name)
