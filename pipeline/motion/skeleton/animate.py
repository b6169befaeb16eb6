"""Motion of all people: smoothing or skeleton fit, standing feet held in place, and hands."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Animation, Floor, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import FINGER_JOINTS, MARKED_AT_CENTERS, JointOffsets, JointSet, without_hands
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.rules import cutoff_problems, require
from pipeline.core.progress import OnShare, ignore, split
from pipeline.motion.body_segments import SEGMENTS
from pipeline.motion.skeleton.feet.floor import shared_floor
from pipeline.motion.skeleton.feet.stances import FootPoints, foot_contacts, foot_points, hold_feet
from pipeline.motion.skeleton.fitting.fit import FitState, SkeletonFit, fit_to_rays, follow
from pipeline.motion.skeleton.hands import whole
from pipeline.motion.skeleton.model import INDEX, find_skeleton, forward_kinematics, posed_joints
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw
from pipeline.motion.skeleton.time_series import smooth_track

# Shares of the computing time: of the fit, positions and skeleton motion; then holding feet, positions from the motion.
_FITTING, _FINISHING = (6, 6), (3, 1)


@dataclass(frozen=True, slots=True, eq=False)
class FittedPerson:
    """Person whose skeleton is fitted, before feet are held: several people share the floor."""

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

    ``docs/methods/fit.md`` describes the method, with its sources.

    - ``tracks``: tracks with the joints located by association: world positions (frames, joints, 3) in metres, NaN
      where a joint is unknown.
    - ``observations``: observations of the tracks, in the same order. Each is asked for twice, and only one person's
      are kept at a time: they may be read from a file.
    - ``config``: method of smoothing, and treatment of feet. With ``fit``, the final joint positions are the
      skeleton's. Otherwise each joint is smoothed by itself, and the skeleton follows the joints.
    - ``offsets``: offsets of the detector's marks from the joints' centres. Only the fit can move joints to their
      centres.
    - ``floor``: floor under the people; ``None``: there is none; ``estimated``: it is estimated from their feet.

    Returns tracks with final positions, NaN where the fit has no evidence of a joint, and motions, finite in all
    frames. Raises ``InputError`` if the cutoff of the low-pass is not below half of the frame rate.

    >>> from pipeline.core.joints import COCO_17
    >>> animate([], [], [], Timebase(0.0, 30.0, 0), COCO_17, ReconstructionConfig()).motions
    ()
    """
    fitter = PersonFitter(cameras, timebase, joints, config, offsets)
    num_frames = [track.num_frames for track in tracks]
    parts = iter(split(on_share, [sum(shares) * num for shares in (_FITTING, _FINISHING) for num in num_frames]))
    fitted = [fitter.fit(tracks[number], observations[number], next(parts)) for number in range(len(tracks))]
    if floor == "estimated":
        floor = floor_under([person.points for person in fitted], timebase.frame_rate_hz)
    finished = [
        fitter.finish(person, tracks[number], observations[number], floor, next(parts))
        for number, person in enumerate(fitted)
    ]
    on_share(1.0)
    return Animation(tuple(track for track, _ in finished), tuple(motion for _, motion in finished), floor)


def floor_under(people: Sequence[FootPoints], frame_rate_hz: float) -> Floor | None:
    """Floor under people, from the points of their feet; ``None`` if no foot was ever seen."""
    return shared_floor(
        [person.ankles_m for person in people],
        [person.ankles_known for person in people],
        [person.support.carries for person in people],
        frame_rate_hz,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PersonFitter:
    """Fit of the people of a take, one at a time; see ``animate``."""

    cameras: Sequence[Camera]
    timebase: Timebase
    joints: JointSet
    config: ReconstructionConfig
    offsets: JointOffsets

    def fit(self, track: Track3D, seen: Observations, on_share: OnShare = ignore) -> FittedPerson:
        """Fit a person's skeleton, up to where the floor counts."""
        require(cutoff_problems(self.config.smoothing, self.config.cutoff_hz, self.timebase.frame_rate_hz))
        on_positions, on_motion = split(on_share, _FITTING)
        fit = self._prepared(*whole.selected(track, seen, self.joints, self._body.names), on_positions)
        motion = fit.motion(on_motion)
        return FittedPerson(fit.state, foot_points(fit, motion, self._body))

    def finish(
        self, fitted: FittedPerson, track: Track3D, seen: Observations, floor: Floor | None, on_share: OnShare = ignore
    ) -> tuple[Track3D, SkeletonMotion]:
        """Hold a fitted person's feet on the floor; return the final track and motion, with hands."""
        on_held, on_followed = split(on_share, _FINISHING)
        _, body_seen = whole.selected(track, seen, self.joints, self._body.names)
        fit = SkeletonFit.resumed(
            fitted.state, body_seen, self.cameras, self.timebase, self._body, self.offsets, self._by_rays
        )
        contacts = foot_contacts(fitted.points, floor, self.timebase.frame_rate_hz, self.config.feet)
        motion = hold_feet(fit, fit.current, fitted.points, contacts, floor, on_held)
        followed = follow(fit, motion, body_seen, self.cameras, on_followed) if self._by_rays else fit.track
        if whole.has_fingers(self.joints):
            motion, followed = self._with_hands(motion, followed, track, seen, fit.has_torso)
        return followed, turned_as_stated(motion, followed)

    @property
    def _body(self) -> JointSet:
        return without_hands(self.joints)

    @property
    def _by_rays(self) -> bool:
        return self.config.smoothing == "fit" and bool(self.cameras)  # 3D points have no rays

    def _prepared(self, track: Track3D, seen: Observations, on_share: OnShare) -> SkeletonFit:
        """Prepare the fit of a body, without hands."""
        name = f"person-{track.track_id}"
        if self._by_rays:
            return fit_to_rays(track, seen, self.cameras, self.timebase, self._body, name, self.offsets, on_share)
        return SkeletonFit(self._smoothed(track, seen), self._body, self.timebase, name)

    def _smoothed(self, track: Track3D, seen: Observations) -> Track3D:
        return smooth_track(track, seen, self.cameras, self.timebase, self.config)

    def _with_hands(
        self, motion: SkeletonMotion, followed: Track3D, track: Track3D, seen: Observations, is_placed: bool
    ) -> tuple[SkeletonMotion, Track3D]:
        """Fit the hands of a person on the fitted body, and add their joints to the motion and to the track.

        ``motion``, ``followed``: motion and final joints of the body. ``track``, ``seen``: located joints with their
        observations, fingers included. ``is_placed``: true if the body's position is known; otherwise hands are in the
        natural pose, and fingers stay where they are.
        """
        start = track if self._by_rays else self._smoothed(track, seen)
        views = whole.views_of_hands(start, seen, self.joints, self.timebase.frame_rate_hz)
        if not is_placed:
            views = {side: whole.unseen(view) for side, view in views.items()}
        hands = whole.fit_hands(motion, start, views, self.joints, self.cameras if self._by_rays else None)
        if self._by_rays and is_placed:
            fingers = whole.follow_hands(followed, motion, hands, track, seen, self.joints, self.cameras)
        else:
            fingers, _ = whole.selected(
                start, seen, self.joints, [name for name in self.joints.names if name in FINGER_JOINTS]
            )
        return whole.with_hands(motion, hands), whole.with_fingers(followed, fingers, self.joints)


_PLACED = tuple(INDEX[f"{side}{bone}"] for side in ("Left", "Right") for bone in ("UpLeg", "Leg", "Foot", "Arm"))


def turned_as_stated(motion: SkeletonMotion, track: Track3D) -> SkeletonMotion:
    """Motion whose bones have the orientations that ``track.world_from_segment`` states, and others the fit's turns.

    The body is moved so that hips, knees, ankles and shoulders stay where the fit has them on average. Feet are then
    held by the stated orientations, so no contact is pinned. A motion without stated orientations is returned as it is.
    """
    if track.world_from_segment is None:
        return motion
    skeleton = find_skeleton(len(motion.bone_length_m))
    positions_m, fitted = posed_joints(motion)
    local = Rotation.from_quat(motion.parent_from_joint.reshape(-1, 4)).as_matrix()
    local = local.reshape(len(motion.root_m), len(skeleton), 3, 3)
    stated = {
        INDEX[segment.joint]: track.world_from_segment[:, number] @ segment.rest_from_segment.T
        for number, segment in enumerate(SEGMENTS.values())
    }
    world = list(fitted)
    quat = np.array(motion.parent_from_joint)
    for index, joint in enumerate(skeleton):
        above = world[INDEX[joint.parent]] if joint.parent else np.eye(3)
        world[index] = above @ local[:, index]
        if index in stated:
            known = np.isfinite(stated[index]).all((-1, -2))
            world[index] = np.where(known[:, None, None], stated[index], world[index])
            turn = Rotation.from_matrix(np.swapaxes(np.broadcast_to(above, world[index].shape), -1, -2) @ world[index])
            quat[:, index] = continuous_quat_xyzw(turn)
    turned = replace(
        motion,
        parent_from_joint=read_only(quat),
        contacts=tuple(
            replace(contact, pinned=False, slide_after_m=contact.slide_before_m) for contact in motion.contacts
        ),
    )
    moved_m = (positions_m - forward_kinematics(turned))[:, _PLACED].mean(1)
    return replace(turned, root_m=read_only(motion.root_m + moved_m))
