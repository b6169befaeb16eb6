"""Motion of all people: smoothing or skeleton fit, and standing feet held in place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.config import ReconstructionConfig
from pipeline.data import Animation, Camera, FootContact, Observations, Side, SkeletonMotion, Timebase, Track3D
from pipeline.joints import MARKED_AT_CENTERS, JointOffsets, JointSet
from pipeline.progress import OnShare, ignore, split
from pipeline.skeleton.feet import SIDES, estimate_floor, find_contacts, held_positions_m, mean_slide_m, stance_weight
from pipeline.skeleton.fitting.fit import SkeletonFit, fit_to_rays, follow
from pipeline.skeleton.model import joint_pose
from pipeline.skeleton.rotations import from_axes
from pipeline.skeleton.smooth import check_smoothing, smooth_track

_LEFT, _UP, _HORIZONTAL = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])
# Limit on the bend of an ankle from the right angle with the shin.
_MAX_BEND_RAD = np.radians(45.0)
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
) -> Animation:
    """Compute the skeleton motion and the final joint positions of all people.

    Parameters
    ----------
    tracks
        Tracks with the joints located by association.
    observations
        Observations of the tracks, in the same order.
    joints
        Joint set of the tracks.
    config
        Method of smoothing, and treatment of feet. With ``fit``, the final joint positions are those of the skeleton.
        Otherwise each joint is smoothed by itself, and the skeleton follows the joints.
    on_share
        Called with the progress after each window of a track's frames.
    offsets
        Offsets of the detector's marks from the joints' centres. Only the fit can move joints to their centres.

    Raises
    ------
    InputError
        See ``check_smoothing``.
    """
    check_smoothing(timebase, config)
    num_frames = [track.num_frames for track in tracks]
    work = [share * num for shares in (_WORK[:2], _WORK[2:]) for num in num_frames for share in shares]
    parts = iter(split(on_share, work))
    fits: list[SkeletonFit] = []
    motions: list[SkeletonMotion] = []
    for track, seen in zip(tracks, observations, strict=True):
        fits.append(_prepare(track, seen, cameras, timebase, joints, config, offsets, next(parts)))
        motions.append(fits[-1].motion(next(parts)))
    rate_hz = timebase.frame_rate_hz
    ankles_m = [_ankles_m(motion) for motion in motions]
    known = [_ankles_known(fitted.track, joints) for fitted in fits]
    floor = estimate_floor(ankles_m, known, rate_hz)
    finals: list[Track3D] = []
    for number, seen in enumerate(observations):
        contacts = find_contacts(ankles_m[number], known[number], floor, rate_hz, config.feet)
        motions[number] = _hold_feet(fits[number], motions[number], ankles_m[number], contacts, next(parts))
        on_followed = next(parts)
        finals.append(
            follow(fits[number], motions[number], seen, cameras, on_followed)
            if config.smoothing == "fit"
            else fits[number].track
        )
    on_share(1.0)
    return Animation(tuple(finals), tuple(motions), floor)


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


def _ankles_m(motion: SkeletonMotion) -> Float[np.ndarray, "frames 2 3"]:
    return np.stack([joint_pose(motion, f"{side.capitalize()}Foot")[0] for side in SIDES], axis=1)


def _ankles_known(track: Track3D, joints: JointSet) -> Bool[np.ndarray, "frames 2"]:
    names = [f"{side}_ankle" for side in SIDES]
    if not set(names) <= set(joints.names):
        return np.zeros((track.num_frames, 2), dtype=bool)
    return np.asarray(np.isfinite(track.xyz_m[:, joints.indices(tuple(names))]).all(-1))


def _hold_feet(
    fitted: SkeletonFit,
    motion: SkeletonMotion,
    ankles_m: Float[np.ndarray, "frames 2 3"],
    contacts: tuple[FootContact, ...],
    on_share: OnShare,
) -> SkeletonMotion:
    """Hold standing feet in place; level them if neither toes nor heels are known."""
    places_m = held_positions_m(ankles_m, contacts, motion.frame_rate_hz)
    if np.isfinite(places_m).any():
        fitted.pin({f"{side}_ankle": places_m[:, foot] for foot, side in enumerate(SIDES)}, on_share)
        ankles_m = _ankles_m(motion)
    after = [mean_slide_m(ankles_m[contact.rows, SIDES.index(contact.side)]) for contact in contacts]
    slid = (replace(contact, slide_after_m=slide_m) for contact, slide_m in zip(contacts, after, strict=True))
    motion = replace(motion, contacts=tuple(slid))
    if not fitted.sees_feet:
        for side in SIDES:
            fitted.turn(f"{side.capitalize()}Foot", _foot_without_toes(motion, side))
    return motion


def _foot_without_toes(motion: SkeletonMotion, side: Side) -> Rotation:
    """Rotation from foot to shin where only the ankle is known.

    The foot is at a right angle to the shin in the air, and level on the floor. A standing foot points in the direction
    that the shin faces. Both orientations are blended before and after a stance.
    """
    share = stance_weight(motion.contacts, side, len(motion.root_m), motion.frame_rate_hz)
    _, world_from_shin = joint_pose(motion, f"{side.capitalize()}Leg")
    left = world_from_shin.apply(_LEFT) * _HORIZONTAL
    level, is_known = from_axes(left, np.broadcast_to(_UP, left.shape))
    bend = (world_from_shin.inv() * level).as_rotvec()
    angle_rad = np.linalg.norm(bend, axis=-1)
    share = share * is_known * np.minimum(1.0, _MAX_BEND_RAD / np.maximum(angle_rad, 1e-9))
    return Rotation.from_rotvec(bend * share[:, None])
