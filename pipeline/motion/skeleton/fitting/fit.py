"""Skeleton fit of a person over time, with bones of constant length and hinges that bend one way."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffsets, JointSet
from pipeline.core.progress import OnShare, ignore
from pipeline.core.runtime import large_arrays
from pipeline.geometry.tracks import reproject
from pipeline.motion.skeleton import marks
from pipeline.motion.skeleton.fitting import uncertainty
from pipeline.motion.skeleton.fitting.articulation import FREEDOMS, Articulation, articulate
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, landmark_positions, refine, start_from
from pipeline.motion.skeleton.fitting.landmark_evidence import LandmarkEvidence
from pipeline.motion.skeleton.fitting.lengths import learn_lengths
from pipeline.motion.skeleton.fitting.liveliness import liveliness
from pipeline.motion.skeleton.fitting.positions import MAX_GAP_S, SCALES_M, fit_positions, stretches, usual_step_m
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.fitting.solve import solve_pose
from pipeline.motion.skeleton.landmarks import Landmarks, bone_lengths_m
from pipeline.motion.skeleton.model import INDEX, SKELETON
from pipeline.motion.skeleton.rigid_parts import landmark_offsets_m
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw, filled
from pipeline.motion.skeleton.time_series import Blend, gaps_up_to, windows

_NUM_STEPS = 6
_NUM_STEPS_PINNED = 3
_NUM_STEPS_APART = 15
# Standard deviations of positions as evidence: smoothed positions, positions in gaps, positions that were predicted
# where one camera alone sees the person, and positions of held feet.
_PLACED_M, _BRIDGE_M, _PREDICTED_M, _PIN_M = 0.01, 0.10, 0.30, 0.001
# Smoothed positions farther than this from the start of the fit are outliers and ignored.
_REACH_M = 0.15

# Windows of frames from which the lengths of bones are learnt, at most.
_NUM_LEARNT_WINDOWS = 3

_RaysOf = Callable[[slice], Rays]


def _rays_in(seen: Observations, cameras: Sequence[Camera], joints: JointSet) -> _RaysOf:
    """Rays of a person's observations in a window of frames."""
    return lambda rows: Rays(cameras, seen.points_px[rows], seen.score[rows], joints)


@dataclass(frozen=True, slots=True, eq=False)
class FitState:
    """State of a person's fit after ``SkeletonFit.motion``, without the observations, for ``SkeletonFit.resumed``."""

    track: Track3D  # Positions at the start of the fit
    motion: SkeletonMotion
    # See ``SkeletonFit``
    is_predicted: Bool[np.ndarray, "frames joints"]
    lively: Float[np.ndarray, " frames"]
    has_offsets: bool
    uncertainty_m: Float[np.ndarray, "frames joints"] | None


@dataclass(frozen=True, slots=True, eq=False)
class FittedProportions:
    """Proportions that a fit learns of a person: lengths of bones; offsets of landmarks in head and feet, by name."""

    bone_length_m: Float[np.ndarray, " joints"]
    offsets_m: Mapping[str, Float[np.ndarray, " 3"]]


class SkeletonFit:
    """Skeleton fit of a person.

    - ``track``: joint positions, NaN in gaps.
    - ``rays_of``: returns the rays in a window of frames, which the fit follows. ``None``: the fit follows the
      positions.
    - ``offsets``: offsets of the detector's marks, to which the rays lead, from the joints' centres, at which the
      positions are.
    - ``is_predicted``: positions that are weak evidence beside the rays, as one camera alone sees the person. ``None``:
      none is.
    - ``lively``: ratio of the person's accelerations to usual ones, see ``fitting.liveliness``. ``None``: they are
      usual.
    - ``bone_length_m``: lengths of the bones at the start. ``None``: they are measured between the positions.
    - ``known``: proportions of the person, which stay as they are. ``None``: ``motion`` learns them.
    """

    def __init__(
        self,
        track: Track3D,
        joints: JointSet,
        timebase: Timebase,
        name: str,
        rays_of: _RaysOf | None = None,
        offsets: JointOffsets = MARKED_AT_CENTERS,
        is_predicted: Bool[np.ndarray, "frames joints"] | None = None,
        lively: Float[np.ndarray, " frames"] | None = None,
        bone_length_m: Float[np.ndarray, " joints"] | None = None,
        known: FittedProportions | None = None,
    ) -> None:
        self._track, self._joints, self._timebase, self._name, self._rays_of = track, joints, timebase, name, rays_of
        self._is_predicted = np.zeros(track.source.shape, bool) if is_predicted is None else is_predicted
        self._lively = np.ones(track.num_frames) if lively is None else lively
        self._offsets, self._known = offsets, known
        if known is not None:
            bone_length_m = known.bone_length_m
        if bone_length_m is None:
            bone_length_m = bone_lengths_m(Landmarks(track.xyz_m, track.source, joints, track.views))
        self._use_lengths(bone_length_m)
        usual_m = usual_step_m(joints, timebase)[self._skeleton.landmark]
        self._usual_m = usual_m if rays_of else np.full_like(usual_m, np.inf)
        self._uncertainty_m: np.ndarray | None = None
        self._pin_m, self._damping = _PIN_M, 0.0

    @classmethod
    def resumed(
        cls,
        state: FitState,
        seen: Observations,
        cameras: Sequence[Camera],
        timebase: Timebase,
        joints: JointSet,
        offsets: JointOffsets,
        follows_rays: bool,
    ) -> "SkeletonFit":
        """Go on with the fit of a person from its state, which stays as it is.

        ``follows_rays`` tells whether it follows the rays of ``seen``, see ``fit_to_rays``; ``offsets`` are as there.
        """
        motion = state.motion
        fitted = cls(
            state.track,
            joints,
            timebase,
            motion.name,
            _rays_in(seen, cameras, joints) if follows_rays else None,
            offsets if state.has_offsets else MARKED_AT_CENTERS,
            state.is_predicted,
            state.lively,
            motion.bone_length_m,
        )
        fitted.set_pose(motion.root_m, motion.parent_from_joint)
        fitted._uncertainty_m = state.uncertainty_m
        return fitted

    @property
    def state(self) -> FitState:
        """State after ``motion``; the motion's arrays are the fit's."""
        return FitState(
            self._track, self.current, self._is_predicted, self._lively, bool(self._offsets), self._uncertainty_m
        )

    @property
    def track(self) -> Track3D:
        """Positions at the start of the fit."""
        return self._track

    @property
    def uncertainty_m(self) -> Float[np.ndarray, "frames joints"] | None:
        """Standard deviation of the joints' positions in metres, of the motion before feet were held.

        NaN for joints that the skeleton does not carry. ``None`` before ``motion``, without rays, and for a person
        without hips and shoulders.
        """
        return self._uncertainty_m

    @property
    def carried(self) -> frozenset[str]:
        """Names of the joints that the skeleton carries."""
        return frozenset(self._joints.names[number] for number in self._skeleton.landmark)

    @property
    def sees_feet(self) -> bool:
        """True if toes or heels determine the rotation of feet."""
        return len(self._skeleton.freedoms) > len(FREEDOMS)

    def offset_m(self, name: str) -> Float[np.ndarray, " 3"] | None:
        """Offset of a landmark of head or foot in its part's axes (metres); ``None`` if it was never known."""
        return self._offsets_m.get(name)

    @property
    def has_torso(self) -> bool:
        """True if a hip or a shoulder was ever located; without them, the skeleton's position is arbitrary."""
        return marks.has_torso(self._track.xyz_m, self._joints)

    def motion(self, on_share: OnShare = ignore) -> SkeletonMotion:
        """Fit the skeleton, starting from rotations computed from the positions."""
        num_frames = self._track.num_frames
        self._root_m, self._quat = np.empty((num_frames, 3)), large_arrays.empty((num_frames, len(SKELETON), 4))
        start = self._start
        if self._rays_of is None or not self.has_torso:
            self._fit(start, {}, _NUM_STEPS, on_share)
        else:
            if self._known is None:
                self._use_lengths(self._learnt_lengths_m())
            sigma_m = np.empty((num_frames, len(self._skeleton.landmark)))
            self._fit(start, {}, _NUM_STEPS, on_share, Blend(sigma_m))
            self._uncertainty_m = np.full(self._track.xyz_m.shape[:2], np.nan)
            self._uncertainty_m[:, self._skeleton.landmark] = sigma_m
        return self.current

    @property
    def current(self) -> SkeletonMotion:
        """Motion as it is now, without contacts; what changes the fit changes it too."""
        return SkeletonMotion(
            track_id=self._track.track_id,
            name=self._name,
            start_frame=self._track.start_frame,
            frame_rate_hz=self._timebase.frame_rate_hz,
            bone_length_m=read_only(self._bone_length_m),
            root_m=read_only(self._root_m.view()),
            parent_from_joint=read_only(self._quat.view()),
            contacts=(),
        )

    def _stated_m(self, bodies: JointPoses, evidence: LandmarkEvidence) -> Float[np.ndarray, "frames landmarks"]:
        """Standard deviation of each landmark of a window, in metres."""
        of_noise = uncertainty.NETWORK_LASTING if self._offsets else uncertainty.SIMULATED_LASTING
        rate_hz = self._timebase.frame_rate_hz
        stated_m = uncertainty.uncertainty_m(bodies, self._skeleton, evidence, rate_hz, of_noise)
        share = evidence.disagreement(landmark_positions(bodies, self._skeleton))
        return np.hypot(stated_m, uncertainty.disagreement_m(share))

    def _start(self, rows: slice) -> JointPoses:
        """Pose that the joints of a window suggest."""
        landmarks = Landmarks(self._track.xyz_m[rows], self._track.source[rows], self._joints)
        return start_from(*solve_pose(landmarks, self._bone_length_m, self._timebase.frame_rate_hz), self._skeleton)

    def _is_tied(self, rows: slice) -> Bool[np.ndarray, " steps"] | None:
        """Steps between frames that no pause parts; ``None`` without a pause."""
        parts = self._stretches(rows)
        if len(parts) == 1:
            return None
        is_tied = np.zeros(parts[-1].stop - 1, dtype=bool)
        for part in parts:
            is_tied[part.start : part.stop - 1] = True
        return is_tied

    def _stretches(self, rows: slice) -> list[slice]:
        """Ranges of frames of a window between pauses."""
        is_seen = np.isfinite(self._track.xyz_m[rows]).all(-1).any(-1)
        return stretches(is_seen, round(MAX_GAP_S * self._timebase.frame_rate_hz))

    def _usual_step_m(self, rows: slice) -> Float[np.ndarray, "differences landmarks"]:
        """Usual second differences of landmarks in a window."""
        return np.asarray(self._lively[rows][1:-1, None] * self._usual_m)

    def _use_lengths(self, bone_length_m: Float[np.ndarray, " joints"]) -> None:
        """Build the skeleton with lengths of bones, and measure heads and feet with it."""
        self._bone_length_m = bone_length_m
        known = self._known
        offsets_m = landmark_offsets_m(self._track, self._joints, bone_length_m) if known is None else known.offsets_m
        self._offsets_m = offsets_m
        self._centers = articulate(bone_length_m, self._joints, self._offsets_m)
        self._skeleton = self._marked(bone_length_m) if self._offsets else self._centers

    def _marked(self, bone_length_m: Float[np.ndarray, " joints"]) -> Articulation:
        """Skeleton with other lengths of bones, whose landmarks are the detector's marks."""
        marks_m = marks.mark_offsets_m(self._joints, self._offsets, marks.trunk_length_m(bone_length_m))
        return articulate(bone_length_m, self._joints, self._offsets_m, marks_m)

    def _learnt_lengths_m(self) -> Float[np.ndarray, " joints"]:
        """Lengths of bones from windows that are spread evenly over the track."""
        rows = list(windows(self._track.num_frames))
        chosen = np.unique(np.linspace(0, len(rows) - 1, _NUM_LEARNT_WINDOWS).round().astype(int))
        spread = []
        for number in chosen.tolist():
            bodies = self._start(rows[number])
            bodies.is_tied = self._is_tied(rows[number])
            spread.append((bodies, self._evidence(rows[number], bodies, {}), self._usual_step_m(rows[number])))
        return learn_lengths(self._bone_length_m, self._marked, spread, self._timebase.frame_rate_hz)

    def set_pose(self, root_m: Float[np.ndarray, "frames 3"], quat_xyzw: Float[np.ndarray, "frames joints 4"]) -> None:
        """Set the motion, which ``pin`` refines."""
        self._root_m, self._quat = np.array(root_m), large_arrays.copy(quat_xyzw)

    def pin(
        self,
        places_m: Mapping[str, Float[np.ndarray, "frames 3"]],
        on_share: OnShare = ignore,
        sigma_m: float = _PIN_M,
        num_steps: int = _NUM_STEPS_PINNED,
        damping: float = 0.0,
    ) -> None:
        """Refine the motion with landmarks held at given positions, within a standard deviation.

        ``damping`` is for landmarks that are held far from where they are, see ``gauss_newton.refine``.

        The motion is changed in place, because two motions of a long session would need too much memory. Positions
        (metres, in the world) are by landmark, NaN in frames and along axes in which it is free.
        """
        self._pin_m, self._damping = sigma_m, damping

        def start(rows: slice) -> JointPoses:
            return start_from(self._root_m[rows], self._quat[rows], self._skeleton)

        self._fit(start, places_m, num_steps, on_share)

    def turn(self, name: str, rotation: Rotation) -> None:
        """Set the rotation of a joint to its parent in all frames of the motion, in place."""
        self._quat[:, INDEX[name]] = continuous_quat_xyzw(rotation)

    def place(self, rows: slice, xyz_m: Float[np.ndarray, "frames joints 3"]) -> None:
        """Replace joint positions by the motion's, in place; unknown joints stay NaN."""
        bodies = start_from(self._root_m[rows], self._quat[rows], self._centers)
        landmark = self._centers.landmark
        known = np.isfinite(xyz_m[:, landmark])
        xyz_m[:, landmark] = np.where(known, landmark_positions(bodies, self._centers), np.nan)

    def marks_m(
        self, rows: slice, motion: SkeletonMotion, xyz_m: Float[np.ndarray, "rows joints 3"]
    ) -> Float[np.ndarray, "rows joints 3"]:
        """Marks that the detector would set at joint positions of the final motion; unknown joints stay NaN."""
        return marks.marks_from_centers(xyz_m, motion, rows, self._joints, self._offsets)

    def _fit(
        self,
        start: Callable[[slice], JointPoses],
        places_m: Mapping[str, Float[np.ndarray, "frames 3"]],
        num_steps: int,
        on_share: OnShare,
        sigma_m: Blend | None = None,
    ) -> None:
        root_m, quat = Blend(self._root_m), Blend(self._quat)
        all_rows = list(windows(self._track.num_frames))
        following = start(all_rows[0])
        for number, rows in enumerate(all_rows):
            bodies = following
            if number + 1 < len(all_rows):
                # Before this window changes the frames of the overlap.
                following = start(all_rows[number + 1])
            bodies.is_tied = self._is_tied(rows)
            evidence = self._evidence(rows, bodies, {name: place_m[rows] for name, place_m in places_m.items()})
            # After a pause, the start of the fit is often far off.
            steps = num_steps if bodies.is_tied is None or places_m else _NUM_STEPS_APART
            refine(
                bodies,
                self._skeleton,
                evidence,
                self._usual_step_m(rows),
                self._timebase.frame_rate_hz,
                steps,
                self._damping,
            )
            if sigma_m is not None:
                sigma_m.add(rows, self._stated_m(bodies, evidence))
            root_m.add(rows, bodies.root_m)
            quat.add(rows, _same_signs(bodies.quat_xyzw(), self._quat[rows.start] if rows.start else None))
            # Blended quaternions are not of length 1.
            self._quat[rows] /= np.linalg.norm(self._quat[rows], axis=-1, keepdims=True)
            on_share((number + 1) / len(all_rows))
        self._bridge_pauses()

    def _bridge_pauses(self) -> None:
        """Let root and rotations pass evenly over pauses, from one fitted frame to the next."""
        is_inside = np.zeros(self._track.num_frames, dtype=bool)
        for part in self._stretches(slice(None)):
            is_inside[part] = True
        if is_inside.all():
            return
        frames, inside = np.arange(len(is_inside)), np.flatnonzero(is_inside)
        for axis in range(3):
            self._root_m[:, axis] = np.interp(frames, inside, self._root_m[inside, axis])
        for joint in range(self._quat.shape[1]):
            rotation = filled(Rotation.from_quat(self._quat[:, joint]), is_inside)
            self._quat[:, joint] = continuous_quat_xyzw(rotation)

    def _evidence(
        self, rows: slice, start: JointPoses, places_m: Mapping[str, Float[np.ndarray, "frames 3"]]
    ) -> LandmarkEvidence:
        """Evidence for the fit of a window. In gaps, the targets are the positions at the start of the fit."""
        position_m = np.array(self._track.xyz_m[rows])
        landmark = self._skeleton.landmark
        if self._skeleton is not self._centers:
            position_m[:, landmark] += landmark_positions(start, self._skeleton) - landmark_positions(
                start, self._centers
            )
        xyz_m = position_m[:, landmark]
        start_m = landmark_positions(start, self._skeleton)
        known = np.isfinite(xyz_m)
        if self._rays_of is None:
            # Without rays, only the start of the fit can identify outliers.
            known &= np.linalg.norm(xyz_m - start_m, axis=-1, keepdims=True) <= _REACH_M
        place_m = np.where(known, xyz_m, start_m)
        strength = np.where(known, 0.0 if self._rays_of else 1.0 / _PLACED_M**2, 1.0 / _BRIDGE_M**2)
        is_predicted = self._is_predicted[rows][:, landmark, None]
        strength = np.where(known & is_predicted, 1.0 / _PREDICTED_M**2, strength)
        for name, pin_m in places_m.items():
            number = landmark.tolist().index(self._joints.index(name))
            pinned = np.isfinite(pin_m)
            strength[:, number] = np.where(pinned, 1.0 / self._pin_m**2, strength[:, number])
            place_m[:, number] = np.where(pinned, pin_m, place_m[:, number])
        rays = self._rays_of(rows) if self._rays_of else None
        if rays is not None:
            rays.exchange_sides(position_m, SCALES_M[-1])
        return LandmarkEvidence(rays, landmark, strength, place_m)


def fit_to_rays(
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    name: str,
    offsets: JointOffsets = MARKED_AT_CENTERS,
    on_share: OnShare = ignore,
    proportions: FittedProportions | None = None,
) -> SkeletonFit:
    """Prepare the fit of a person to the rays of all views.

    Parameters
    ----------
    track
        Person as association located it: joints (frames, joints, 3) in metres, NaN where unknown.
    seen
        Observations of the track in distorted pixels, NaN where a camera does not see a joint.
    offsets
        Offsets of the detector's marks from the joints' centres; unused for a person without hips and shoulders.
    proportions
        Known proportions of the person, see ``SkeletonFit``.

    Returns
    -------
    SkeletonFit
        Fit that is ready for its windows of frames, with positions in metres, NaN in gaps.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pipeline.association.tracking.track_people import reconstruct_tracks
    >>> from pipeline.association.tracking.tracking_parameters import derive_parameters
    >>> from pipeline.validation.simulation.scenes import SCENES, record
    >>> take = record(replace(SCENES["room"], duration_s=1.0), seed=0)
    >>> parameters = derive_parameters(take.cameras, take.timebase.frame_rate_hz)
    >>> tracks, seen = reconstruct_tracks(take.cameras, take.times, take.detections, take.timebase, parameters)
    >>> fit = fit_to_rays(tracks[0], seen[0], take.cameras, take.timebase, take.joints, "person-1")
    >>> fit.has_torso, fit.track.num_frames == tracks[0].num_frames
    (True, True)
    """
    rays_of = _rays_in(seen, cameras, joints)
    lively = liveliness(track, rays_of, usual_step_m(joints, timebase), joints, timebase.frame_rate_hz)
    xyz_m = fit_positions(track, seen, cameras, timebase, joints, lively, on_share)
    measured = track.source == Source.MEASURED
    known = measured | gaps_up_to(measured, round(MAX_GAP_S * timebase.frame_rate_hz))
    predicted = track.source == Source.PREDICTED
    known |= predicted
    # The acceleration prior alone would let the distance from the one camera run away.
    xyz_m[predicted] = track.xyz_m[predicted]
    xyz_m[~known] = np.nan
    source = np.where(known, np.where(measured, Source.MEASURED, Source.PREDICTED), Source.ABSENT)
    offsets = offsets if marks.has_torso(xyz_m, joints) else MARKED_AT_CENTERS
    if offsets:
        marked_length_m = bone_lengths_m(Landmarks(xyz_m, source, joints, track.views))
        for rows in windows(len(xyz_m), overlap=0):
            xyz_m[rows] = marks.centers_from_marks(
                Landmarks(xyz_m[rows], source[rows], joints), offsets, marked_length_m
            )
    positions = replace(track, xyz_m=read_only(xyz_m), source=read_only(source.astype(track.source.dtype)))
    return SkeletonFit(positions, joints, timebase, name, rays_of, offsets, predicted, lively, known=proportions)


def follow(
    fitted: SkeletonFit,
    motion: SkeletonMotion,
    seen: Observations,
    cameras: Sequence[Camera],
    on_share: OnShare = ignore,
) -> Track3D:
    """Track with the joint positions of the fitted motion; unknown joints stay unknown.

    If hips and shoulders were never located, the motion's position is arbitrary, and the joint positions stay
    unchanged. Observations are compared with the detector's marks.
    """
    xyz_m, error_px = large_arrays.copy(fitted.track.xyz_m), large_arrays.empty(fitted.track.error_px.shape)
    for rows in windows(len(xyz_m), overlap=0, on_share=on_share):
        if fitted.has_torso:
            fitted.place(rows, xyz_m[rows])
        marks_m = fitted.marks_m(rows, motion, xyz_m[rows])
        error_px[rows], _, _ = reproject(cameras, marks_m, seen.points_px[rows], seen.score[rows])
    sigma_m = fitted.uncertainty_m
    if sigma_m is not None:
        sigma_m = read_only(np.where(np.isfinite(xyz_m).all(-1), sigma_m, np.nan))
    return replace(fitted.track, xyz_m=read_only(xyz_m), error_px=read_only(error_px), uncertainty_m=sigma_m)


def _same_signs(
    quat: Float[np.ndarray, "frames joints 4"], first: Float[np.ndarray, "joints 4"] | None
) -> Float[np.ndarray, "frames joints 4"]:
    """Flip quaternions to the hemispheres of ``first``, so that windows can be blended."""
    if first is None:
        return quat
    return quat * np.where((quat[0] * first).sum(-1) < 0, -1.0, 1.0)[:, None]
