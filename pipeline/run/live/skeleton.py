"""Skeleton of a person while the person moves: bones learnt from the first seconds, then one pose after the other.

The energy of a pose is the finished fit's (``skeleton.fitting``) with the instants before it held: rays of all
views, priors of the articulation, and Cauchy's function of each landmark's distance from its place by the motion so
far. This place and its uncertainty come from a Kalman filter with usual accelerations as noise (Bar-Shalom, Li and
Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 6.3.2), for each landmark.
"""

from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import MARKED_AT_CENTERS, SIDES, JointOffsets, JointSet
from pipeline.motion.skeleton.fitting.articulation import Articulation, articulate
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, Posed, start_from
from pipeline.motion.skeleton.fitting.positions import usual_step_m
from pipeline.motion.skeleton.fitting.solve import solve_pose
from pipeline.motion.skeleton.landmarks import Landmarks, bone_lengths_m
from pipeline.motion.skeleton.marks import centers_from_marks, mark_offsets_m, trunk_length_m
from pipeline.motion.skeleton.rigid_parts import landmark_offsets_m
from pipeline.run.live.feet import StandingFeet
from pipeline.run.live.pose_steps import PoseSteps, quaternions_from_matrices
from pipeline.run.live.records import LiveSkeleton

# Most instants from which bones are learnt, and the least: a person may be hidden for most of the time.
_MOST_LEARNT, _FEWEST_LEARNT = 60, 8
# Noise of a detector across a ray, and scale of the function of Geman and McClure, as in the finished fit.
_SIGMA_M, _SCALE_M = 0.015, 0.10
_MIN_SCORE = 0.1
# Factor at which Cauchy's function becomes heavy-tailed.
_HEAVY_TAIL = 3.0
# Steps at the first pose, and at those that follow.
_NUM_FIRST_STEPS, _NUM_STEPS = 8, 2
# Time without a pose after which the next one is a first pose.
_LONGEST_GAP_S = 0.5
# Time in which the speed of a landmark that no view shows falls to a third.
_COASTING_S = 0.15
# Speeds at the first pose are unknown: a brisk walk.
_FIRST_SPEED_M_S = 2.0
# Noise of accelerations over the usual ones: the filter takes accelerations of one instant as independent of earlier
# ones, but they last. Of 0.35 to 2.5 this is best or nearly so in the simulated room, at 25 and at 60 Hz.
_MANOEUVRE = 1.6
# Uncertainty of the place of a foot that stands.
_STANDING_M = 0.005
# Joints of a foot that are held, each where it stands itself: a heel rises before the toe.
_FOOT_JOINTS = ("ankle", "heel", "big_toe")
_TORSO = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvidence:
    """Evidence for landmarks at an instant: rays, and the places that the motion so far suggests."""

    ray: Float[np.ndarray, "landmarks cameras 3"]  # Unit vectors in the world; 0 where a view does not show a landmark
    weight: Float[np.ndarray, "landmarks cameras"]  # 1 / variance of each ray; 0 where there is none
    center_m: Float[np.ndarray, "cameras 3"]
    place_m: Float[np.ndarray, "landmarks 3"]
    variance_m2: Float[np.ndarray, " landmarks"]  # Of the places; infinite where none is suggested

    def ray_energy(
        self, landmark_m: Float[np.ndarray, "landmarks 3"]
    ) -> tuple[Float[np.ndarray, "landmarks 3 3"], Float[np.ndarray, "landmarks 3"]]:
        """Curvature and negative gradient of the rays' energy."""
        from_center_m = landmark_m[:, None] - self.center_m
        along_m = (from_center_m * self.ray).sum(-1, keepdims=True)
        off_m = from_center_m - along_m * self.ray
        robust = self.weight * (_SCALE_M**2 / ((off_m**2).sum(-1) + _SCALE_M**2)) ** 2
        turned = robust[..., None] * self.ray
        curvature = robust.sum(-1)[:, None, None] * np.eye(3) - turned.swapaxes(-1, -2) @ self.ray
        return curvature, -(robust[..., None] * off_m).sum(1)

    def precision(self, landmark_m: Float[np.ndarray, "landmarks 3"]) -> Float[np.ndarray, " landmarks"]:
        """Inverse variance of each landmark by its rays, in 1 / m2, mean over the axes."""
        return np.asarray(np.trace(self.ray_energy(landmark_m)[0], axis1=-2, axis2=-1) / 3)

    def spread_m2(self, landmark_m: Float[np.ndarray, "landmarks 3"]) -> Float[np.ndarray, " landmarks"]:
        """Variance of the suggested places, larger where a landmark is far from its place (Cauchy)."""
        ratio2 = ((landmark_m - self.place_m) ** 2).sum(-1) / self.variance_m2
        return np.asarray(self.variance_m2 * (1.0 + ratio2 / _HEAVY_TAIL**2))

    def normal_equations(
        self, landmark_m: Float[np.ndarray, "1 landmarks 3"]
    ) -> tuple[Float[np.ndarray, "1 landmarks 3 3"], Float[np.ndarray, "1 landmarks 3"]]:
        """Curvature and negative gradient of the energy at the current positions of landmarks (metres)."""
        curvature, pull = self.ray_energy(landmark_m[0])
        strength = 1.0 / self.spread_m2(landmark_m[0])
        curvature = curvature + strength[:, None, None] * np.eye(3)
        return curvature[None], (pull + strength[:, None] * (self.place_m - landmark_m[0]))[None]


@dataclass(slots=True, eq=False)
class _Motion:
    """Places and speeds of landmarks, and their covariance, the same along each axis."""

    place_m: Float[np.ndarray, "landmarks 3"]
    velocity_m_s: Float[np.ndarray, "landmarks 3"]
    place_m2: Float[np.ndarray, " landmarks"]
    both_m2_s: Float[np.ndarray, " landmarks"]
    velocity_m2_s2: Float[np.ndarray, " landmarks"]

    def predict(self, step_s: float, usual_m_s2: Float[np.ndarray, " landmarks"]) -> None:
        """Move on in time, with accelerations as noise."""
        noise = usual_m_s2**2
        self.place_m = self.place_m + step_s * self.velocity_m_s
        self.place_m2 = (
            self.place_m2 + 2 * step_s * self.both_m2_s + step_s**2 * self.velocity_m2_s2 + noise * step_s**4 / 4
        )
        self.both_m2_s = self.both_m2_s + step_s * self.velocity_m2_s2 + noise * step_s**3 / 2
        self.velocity_m2_s2 = self.velocity_m2_s2 + noise * step_s**2

    def correct(
        self,
        landmark_m: Float[np.ndarray, "landmarks 3"],
        spread_m2: Float[np.ndarray, " landmarks"],
        precision: Float[np.ndarray, " landmarks"],
        step_s: float,
    ) -> None:
        """Take the landmarks of a pose, which a measurement of this precision (1 / m2) moved from their places.

        ``spread_m2`` is the variance of the places with which the pose was found.
        """
        growth = spread_m2 / self.place_m2
        place_m2, both_m2_s, velocity_m2_s2 = (growth * v for v in (self.place_m2, self.both_m2_s, self.velocity_m2_s2))
        gain = place_m2 * precision / (1.0 + place_m2 * precision)
        change_m = landmark_m - self.place_m
        is_seen = precision > 0
        self.velocity_m_s = np.where(
            is_seen[:, None],
            self.velocity_m_s + (both_m2_s / place_m2)[:, None] * change_m,
            self.velocity_m_s * np.exp(-step_s / _COASTING_S),
        )
        self.place_m = landmark_m
        self.velocity_m2_s2 = velocity_m2_s2 - gain * both_m2_s**2 / place_m2
        self.place_m2, self.both_m2_s = (1.0 - gain) * place_m2, (1.0 - gain) * both_m2_s

    def hold(self, number: int, place_m: Float[np.ndarray, " 3"]) -> None:
        """Expect a landmark at the place where it stands."""
        self.place_m[number], self.velocity_m_s[number] = place_m, 0.0
        self.place_m2[number], self.both_m2_s[number], self.velocity_m2_s2[number] = _STANDING_M**2, 0.0, 0.0

    def release(self, number: int) -> None:
        """Expect a landmark that stood before to move from now on."""
        self.place_m2[number], self.both_m2_s[number] = _SIGMA_M**2, 0.0
        self.velocity_m2_s2[number] = _FIRST_SPEED_M_S**2


@dataclass(frozen=True, slots=True, eq=False)
class LearntBones:
    """A person's bones: lengths, and the skeleton with the person's landmarks of head and feet."""

    length_m: Float[np.ndarray, " bones"]
    skeleton: Articulation  # Its landmarks are the detector's marks
    centers: Articulation  # The same with the joints' centres in their place


def learn_bones(
    learnt_m: Float[np.ndarray, "instants joints 3"],
    joints: JointSet,
    length_m: Float[np.ndarray, " bones"] | None = None,
    offsets: JointOffsets = MARKED_AT_CENTERS,
) -> LearntBones:
    """Learn a person's bones from located joints (metres, NaN where unknown), by medians as the finished fit begins.

    With known lengths only the landmarks of head and feet are learnt. ``offsets`` are the offsets of the detector's
    marks from the joints' centres.
    """
    steps = _learning_steps(learnt_m, joints, length_m, offsets)
    while True:
        try:
            next(steps)
        except StopIteration as last:
            return cast(LearntBones, last.value)


def _learning_steps(
    learnt_m: Float[np.ndarray, "instants joints 3"],
    joints: JointSet,
    length_m: Float[np.ndarray, " bones"] | None,
    offsets: JointOffsets,
) -> Generator[None, None, LearntBones]:
    """Learn bones as ``learn_bones`` does, in steps that take about as long as a pose; the bones are returned."""
    source = np.where(np.isfinite(learnt_m[..., 0]), Source.MEASURED, Source.ABSENT)
    if offsets and _has_torso(learnt_m, joints).any():
        landmarks = Landmarks(learnt_m, source, joints)
        learnt_m = centers_from_marks(landmarks, offsets, bone_lengths_m(landmarks))
        yield
    nothing = np.zeros(source.shape)
    track = Track3D(1, 0, learnt_m, nothing, source, nothing, np.zeros(source.shape, int))
    if length_m is None:
        length_m = bone_lengths_m(Landmarks(learnt_m, source, joints))
        yield
    offsets_m = landmark_offsets_m(track, joints, length_m)
    yield
    centers = articulate(length_m, joints, offsets_m)
    if not offsets:
        return LearntBones(length_m, centers, centers)
    yield
    marks_m = mark_offsets_m(joints, offsets, trunk_length_m(length_m))
    return LearntBones(length_m, articulate(length_m, joints, offsets_m, marks_m), centers)


@dataclass(slots=True, eq=False)
class _FootPair:
    """Joint of the left and the right foot, and where it stands."""

    joints: list[int]  # Positions among the detector's joints
    landmarks: list[int]  # Positions among the skeleton's landmarks
    places: StandingFeet
    is_held: list[bool]


def _pair_feet(skeleton: Articulation, joints: JointSet) -> Iterator[_FootPair]:
    carried = skeleton.landmark.tolist()
    for part in _FOOT_JOINTS:
        pair = [joints.names.index(name) for name in (f"left_{part}", f"right_{part}") if name in joints.names]
        if len(pair) == len(SIDES) and set(pair) <= set(carried):
            yield _FootPair(pair, [carried.index(joint) for joint in pair], StandingFeet(), [False, False])


class PoseFilter:
    """Poses of a person's skeleton, one instant after the other.

    ``bones`` are the person's, ``center_m`` the centres of the cameras.
    """

    def __init__(
        self, bones: LearntBones, joints: JointSet, center_m: Float[np.ndarray, "cameras 3"], rate_hz: float
    ) -> None:
        self.bones = bones
        self._joints, self._center_m, self._rate_hz = joints, center_m, rate_hz
        self._steps = PoseSteps(bones.skeleton)
        # Second differences at 1 Hz are accelerations.
        usual_m_s2 = usual_step_m(joints, Timebase(0.0, 1.0, 1))[bones.skeleton.landmark]
        self._noise_m_s2 = _MANOEUVRE * usual_m_s2
        self._state: tuple[JointPoses, _Motion] | None = None
        self._feet = list(_pair_feet(bones.skeleton, joints))
        self._pose_s = -np.inf
        self._quat: np.ndarray | None = None

    def follow(
        self,
        time_s: float,
        xyz_m: Float[np.ndarray, "joints 3"],
        ray: Float[np.ndarray, "joints cameras 3"],
        score: Float[np.ndarray, "joints cameras"],
    ) -> tuple[LiveSkeleton, Float[np.ndarray, "joints 3"]] | None:
        """Find the pose at an instant; see ``LiveBody.follow``."""
        landmark = self.bones.skeleton.landmark
        is_seen = (score > _MIN_SCORE) & np.isfinite(ray).all(-1)
        rays = np.where(is_seen[..., None], ray, 0.0)[landmark]
        weight = (np.where(is_seen, score**3, 0.0) / _SIGMA_M**2)[landmark]
        step_s = time_s - self._pose_s
        for pair in self._feet:
            if step_s > _LONGEST_GAP_S:
                pair.places.forget()
            pair.places.update(time_s, xyz_m[pair.joints])
        if self._state is not None and step_s <= _LONGEST_GAP_S:
            self._step(*self._state, step_s, rays, weight)
        elif _has_torso(xyz_m[None], self._joints)[0]:
            self._state = self._first(xyz_m, rays, weight)
        else:
            return None
        self._pose_s = time_s
        return self._shown(self._state[0])

    def _first(
        self,
        xyz_m: Float[np.ndarray, "joints 3"],
        ray: Float[np.ndarray, "landmarks cameras 3"],
        weight: Float[np.ndarray, "landmarks cameras"],
    ) -> tuple[JointPoses, _Motion]:
        """Find a first pose from the located joints."""
        skeleton, count = self.bones.skeleton, len(self.bones.skeleton.landmark)
        source = np.where(np.isfinite(xyz_m[None, :, 0]), Source.MEASURED, Source.ABSENT)
        landmarks = Landmarks(xyz_m[None], source, self._joints)
        poses = start_from(*solve_pose(landmarks, self.bones.length_m, self._rate_hz), skeleton)
        evidence = PoseEvidence(ray, weight, self._center_m, np.zeros((count, 3)), np.full(count, np.inf))
        self._steps.take(poses, evidence, _NUM_FIRST_STEPS)
        landmark_m = Posed(poses, skeleton).landmark_m[0]
        place_m2 = 1.0 / np.maximum(evidence.precision(landmark_m), 1.0 / _SIGMA_M**2)
        speeds_m2_s2 = np.full(count, _FIRST_SPEED_M_S**2)
        return poses, _Motion(landmark_m, np.zeros((count, 3)), place_m2, np.zeros(count), speeds_m2_s2)

    def _step(
        self,
        poses: JointPoses,
        motion: _Motion,
        step_s: float,
        ray: Float[np.ndarray, "landmarks cameras 3"],
        weight: Float[np.ndarray, "landmarks cameras"],
    ) -> None:
        """Find the pose that follows, in place."""
        motion.predict(step_s, self._noise_m_s2)
        for pair in self._feet:
            places_m = pair.places.places_m
            stands = np.isfinite(places_m).all(-1).tolist()
            for number, place_m, is_standing, was_held in zip(
                pair.landmarks, places_m, stands, pair.is_held, strict=True
            ):
                if is_standing:
                    motion.hold(number, place_m)
                elif was_held:
                    motion.release(number)
            pair.is_held = stands
        evidence = PoseEvidence(ray, weight, self._center_m, motion.place_m, motion.place_m2)
        self._steps.take(poses, evidence, _NUM_STEPS)
        landmark_m = Posed(poses, self.bones.skeleton).landmark_m[0]
        motion.correct(landmark_m, evidence.spread_m2(landmark_m), evidence.precision(landmark_m), step_s)

    def _shown(self, poses: JointPoses) -> tuple[LiveSkeleton, Float[np.ndarray, "joints 3"]]:
        """Skeleton in a pose, and positions of the detector's joints; rotations continue those before."""
        posed, quat = Posed(poses, self.bones.skeleton), quaternions_from_matrices(poses.local[0])
        if self._quat is not None:
            quat = quat * np.where((quat * self._quat).sum(-1) < 0, -1.0, 1.0)[:, None]
        self._quat = quat
        xyz_m = np.full((len(self._joints.names), 3), np.nan)
        centers = self.bones.centers
        landmark_m = posed.landmark_m if centers is self.bones.skeleton else Posed(poses, centers).landmark_m
        xyz_m[centers.landmark] = landmark_m[0]
        return LiveSkeleton(poses.root_m[0].copy(), quat, self.bones.length_m, posed.joint_m[0]), xyz_m


class LiveBody:
    """Body of a person: bones are learnt for a time, then poses follow each other."""

    def __init__(
        self,
        joints: JointSet,
        center_m: Float[np.ndarray, "cameras 3"],
        rate_hz: float,
        learn_s: float,
        offsets: JointOffsets = MARKED_AT_CENTERS,
    ) -> None:
        self._offsets = offsets
        self._joints, self._center_m, self._rate_hz, self._learn_s = joints, center_m, rate_hz, learn_s
        self._first_s: float | None = None
        self._learnt_s = -np.inf
        self._learnt: deque[Float[np.ndarray, "joints 3"]] = deque(maxlen=_MOST_LEARNT)
        self._learning: Generator[None, None, LearntBones] | None = None
        self._filter: PoseFilter | None = None

    @property
    def bones(self) -> LearntBones | None:
        """The person's bones, as soon as they are learnt."""
        return None if self._filter is None else self._filter.bones

    def recall(self, length_m: Float[np.ndarray, " bones"], bones: LearntBones | None) -> None:
        """Take the bones of a person who was there before, or their lengths alone, in place of those to be learnt."""
        if bones is None:
            bones = learn_bones(np.array(self._learnt), self._joints, length_m, self._offsets)
        self._take(bones)

    @property
    def is_learning(self) -> bool:
        """True if the person was seen often enough, and ``learn_a_step`` has not learnt the bones yet."""
        return self._learning is not None

    def learn_a_step(self) -> None:
        """Take a step of learning, which takes about as long as a pose; ``bones`` are there after the last one."""
        if self._learning is None:
            return
        try:
            next(self._learning)
        except StopIteration as last:
            self._take(last.value)

    def _take(self, bones: LearntBones) -> None:
        self._filter = PoseFilter(bones, self._joints, self._center_m, self._rate_hz)
        self._learning = None
        self._learnt.clear()

    @property
    def num_kept(self) -> int:
        """Number of instants that are kept."""
        return len(self._learnt)

    def follow(
        self,
        time_s: float,
        xyz_m: Float[np.ndarray, "joints 3"],
        ray: Float[np.ndarray, "joints cameras 3"],
        score: Float[np.ndarray, "joints cameras"],
    ) -> tuple[LiveSkeleton, Float[np.ndarray, "joints 3"]] | None:
        """Skeleton at an instant, and positions of the joints by it; ``None`` until bones are learnt.

        ``xyz_m``: located joints, world positions in metres, NaN where unknown. ``ray``, ``score``: viewing rays of the
        joints as unit vectors, NaN where unseen, and the detector's confidence. Returns ``None`` also while hips and
        shoulders were not all located since the person came back into sight. Positions are NaN for joints that the
        skeleton does not carry.
        """
        if self._filter is not None:
            return self._filter.follow(time_s, xyz_m, ray, score)
        if self._learning is None and self._is_seen_enough(time_s, xyz_m):
            self._learning = _learning_steps(np.array(self._learnt), self._joints, None, self._offsets)
        return None

    def _is_seen_enough(self, time_s: float, xyz_m: Float[np.ndarray, "joints 3"]) -> bool:
        """Keep located joints; return whether they suffice to learn bones."""
        self._first_s = time_s if self._first_s is None else self._first_s
        if time_s - self._learnt_s >= self._learn_s / _MOST_LEARNT:
            self._learnt.append(xyz_m)
            self._learnt_s = time_s
        is_over = time_s - self._first_s >= self._learn_s
        return is_over and int(_has_torso(np.array(self._learnt), self._joints).sum()) >= _FEWEST_LEARNT


def _has_torso(xyz_m: Float[np.ndarray, "instants joints 3"], joints: JointSet) -> Bool[np.ndarray, " instants"]:
    """Instants at which hips and shoulders are all located."""
    if not set(_TORSO) <= set(joints.names):
        return np.zeros(len(xyz_m), bool)
    return np.asarray(np.isfinite(xyz_m[:, joints.indices(_TORSO)]).all((1, 2)))
