"""Motion of all people: smoothing or skeleton fit, standing feet held in place, and hands."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pipeline.config import ReconstructionConfig
from pipeline.data.animation import Animation, Floor, SkeletonMotion
from pipeline.data.cameras import Camera, Timebase
from pipeline.data.people import Observations, Track3D
from pipeline.joints import FINGER_JOINTS, MARKED_AT_CENTERS, JointOffsets, JointSet, without_hands
from pipeline.progress import OnShare, ignore, split
from pipeline.rules import cutoff_problems, require
from pipeline.skeleton.feet.floor import shared_floor
from pipeline.skeleton.feet.stances import FootPoints, contacts_of, foot_points, hold_feet
from pipeline.skeleton.fitting.fit import FitState, SkeletonFit, fit_to_rays, follow
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

# Shares of the computing time: of the fit, positions and skeleton motion; then holding feet, positions from the motion.
_FITTING, _FINISHING = (6, 6), (3, 1)


@dataclass(frozen=True, slots=True, eq=False)
class FittedPerson:
    """Person whose skeleton is fitted, before feet are held: the floor is that of several people."""

    state: FitState
    points: FootPoints  # Points of the feet in the fitted motion


@dataclass(frozen=True, slots=True, eq=False)
class FittedFeet:
    """Feet of some of the fitted people."""

    points: tuple[FootPoints, ...]
    # Positions of the people, among everybody, from whose feet the floor is estimated; ``None`` if others know
    on_floor: tuple[int, ...] | None


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

    Raises
    ------
    InputError
        If the cutoff of the low-pass is not below half of the frame rate.
    """
    num_frames = [track.num_frames for track in tracks]
    work = [sum(shares) * num for shares in (_FITTING, _FINISHING) for num in num_frames]
    parts = iter(split(on_share, work))
    setting = cameras, timebase, joints, config, offsets
    fitted = [fit_person(tracks[number], observations[number], *setting, next(parts)) for number in range(len(tracks))]
    if floor == "estimated":
        floor = floor_under([person.points for person in fitted], timebase.frame_rate_hz)
    finished = [
        finish_person(person, tracks[number], observations[number], *setting, floor, next(parts))
        for number, person in enumerate(fitted)
    ]
    on_share(1.0)
    return Animation(tuple(track for track, _ in finished), tuple(motion for _, motion in finished), floor)


def fit_person(
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
    offsets: JointOffsets = MARKED_AT_CENTERS,
    on_share: OnShare = ignore,
) -> FittedPerson:
    """Fit a person's skeleton, up to where the floor counts; see ``animate``."""
    require(cutoff_problems(config.smoothing, config.cutoff_hz, timebase.frame_rate_hz))
    on_positions, on_motion = split(on_share, _FITTING)
    body = without_hands(joints)
    fit = _prepare(*selected(track, seen, joints, body.names), cameras, timebase, body, config, offsets, on_positions)
    motion = fit.motion(on_motion)
    return FittedPerson(fit.state, foot_points(fit, motion, body))


def floor_under(people: Sequence[FootPoints], frame_rate_hz: float) -> Floor | None:
    """Floor under people, from the points of their feet; ``None`` if no foot was ever seen."""
    return shared_floor(
        [person.ankles_m for person in people],
        [person.ankles_known for person in people],
        [person.support.carries for person in people],
        frame_rate_hz,
    )


def finish_person(
    fitted: FittedPerson,
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
    offsets: JointOffsets = MARKED_AT_CENTERS,
    floor: Floor | None = None,
    on_share: OnShare = ignore,
) -> tuple[Track3D, SkeletonMotion]:
    """Hold a fitted person's feet on the floor; return the final track and motion, with hands. See ``animate``."""
    on_held, on_followed = split(on_share, _FINISHING)
    body, by_rays = without_hands(joints), config.smoothing == "fit"
    _, body_seen = selected(track, seen, joints, body.names)
    fit = SkeletonFit.resumed(fitted.state, body_seen, cameras, timebase, body, offsets, by_rays)
    contacts = contacts_of(fitted.points, floor, timebase.frame_rate_hz, config.feet)
    motion = hold_feet(fit, fit.current, fitted.points, contacts, floor, on_held)
    followed = follow(fit, motion, body_seen, cameras, on_followed) if by_rays else fit.track
    if has_fingers(joints):
        motion, followed = _add_hands(motion, followed, track, seen, cameras, timebase, joints, config, fit.has_torso)
    return followed, motion


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
