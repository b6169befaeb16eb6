"""One person for one limb: arms, legs and heads that a body took from its neighbour go to the neighbour.

Detectors make one body of two people's limbs where these overlap in the picture. A limb of an observation is the
neighbour's if the places at which all other views expect the neighbour's limb explain it clearly better than the places
of the person's own. It is taken from the person's observation, and given to the neighbour's where that lacks the joint.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation

from pipeline.association.identity.limbs import REACH_S, arms_and_legs, steady_places
from pipeline.association.identity.merging import relocate, runs
from pipeline.association.identity.side_candidates import SCALE_M
from pipeline.core.data.arrays import mean_known, read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.joints import COCO_17, JointSet, other_side
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import project, projection_matrices
from pipeline.geometry.track_assembly import Person
from pipeline.geometry.tracks import triangulate_frames
from pipeline.geometry.undistortion import undistort_views

# Distance of the middles of two bodies in a picture at which a limb may be either one's, at the nearer one's distance.
_NEAR_M = 1.2


class Window(NamedTuple):
    """Some frames of everybody who is there."""

    person: list[int]  # Positions of the people in the order of all
    xyz_m: Float[np.ndarray, "people frames joints 3"]  # Joints in the world, NaN where unknown
    # Observations in distorted pixels, NaN where a camera has none, and their scores
    points_px: Float[np.ndarray, "people frames cameras joints 2"]
    score: Float[np.ndarray, "people frames cameras joints"]

    def __len__(self) -> int:
        return len(self.person)


def present(persons: Sequence[Person], frames: range) -> list[int]:
    """Positions of the people who are there in a range of output frames."""
    return [k for k, (track, _) in enumerate(persons) if _life(track.start_frame, track.num_frames, frames)]


def select_window(persons: Sequence[Person], frames: range) -> Window:
    """Cut the output frames of a range out of everybody's tracks and observations."""
    there = present(persons, frames)
    num_cameras, num_joints = persons[0][1].score.shape[1:]
    shape = len(there), len(frames), num_cameras, num_joints
    xyz_m = np.full((*shape[:2], num_joints, 3), np.nan)
    points_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
    for row, k in enumerate(there):
        track, seen = persons[k]
        life = _life(track.start_frame, track.num_frames, frames)
        to = slice(life.start - frames.start, life.stop - frames.start)
        rows = slice(life.start - track.start_frame, life.stop - track.start_frame)
        xyz_m[row, to], points_px[row, to], score[row, to] = track.xyz_m[rows], seen.points_px[rows], seen.score[rows]
    return Window(there, xyz_m, points_px, score)


def near_neighbours(window: Window, cameras: Sequence[Camera]) -> Bool[np.ndarray, "people people cameras frames"]:
    """Frames in which a camera sees the middles of two bodies near each other."""
    middle_m = mean_known(window.xyz_m, -2)
    near = np.zeros((len(window), len(window), len(cameras), middle_m.shape[1]), bool)
    for k, camera in enumerate(cameras):
        middle_px = project(camera, middle_m)
        px_per_m = scale_px_per_m(camera, middle_m)
        apart_px = np.linalg.norm(middle_px[:, None] - middle_px, axis=-1)
        near[:, :, k] = apart_px < _NEAR_M * np.maximum(px_per_m[:, None], px_per_m)
    near[np.arange(len(window)), np.arange(len(window))] = False
    return near


def expected_without(
    ideal_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    camera: int,
    cameras: Sequence[Camera],
    min_score: float,
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames joints 3"]:
    """Expected places of a person's joints in the world in metres without a camera's observations.

    Observations are undistorted. Places are medians over time; NaN where fewer than two other views see a joint for
    long. Without the camera's own observations its error can't confirm itself.
    """
    others = [k for k in range(len(cameras)) if k != camera]
    projections = projection_matrices([cameras[k] for k in others])
    xyz_m = triangulate_frames(projections, ideal_px[:, others], score[:, others], min_score)
    return steady_places(xyz_m, np.isfinite(xyz_m).all(-1), frame_rate_hz)


def scale_px_per_m(camera: Camera, xyz_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Pixels of a metre across the view at the distance of points."""
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    return np.asarray(focal_px / np.maximum(camera.cam_from_world.apply(xyz_m)[..., 2], 1e-3))


def _life(start_frame: int, num_frames: int, frames: range) -> range:
    """Frames of a track in a range of frames."""
    return range(max(start_frame, frames.start), min(start_frame + num_frames, frames.stop))


# Gain of an explanation, in observations that nothing explains, that decides for the neighbour.
_CLEARLY = 0.6
# Share by which the places from all views may explain a limb less than places from the other views.
_ROUGHLY = 0.2
# Expected places get better when limbs have gone to their owners.
_NUM_ROUNDS = 2
# Frames that are worked on at once, to bound the memory. Crowds get shorter blocks, down to the smallest, with at most
# so many pairs of people over all frames.
_BLOCK, _MIN_BLOCK = 512, 8
_MAX_PAIRS = 4_000_000
_FACE = COCO_17.names[: COCO_17.index("left_shoulder")]


def return_limbs(
    persons: Sequence[Person], cameras: Sequence[Camera], timebase: Timebase, joints: JointSet, min_score: float
) -> list[Person]:
    """Give limbs that bodies took from neighbours to these, and locate the joints again there.

    Observations with a score below ``min_score`` are not used. Without neighbours in a picture, people are returned as
    they are; so they are if the joints have no trunk.
    """
    returned = list(persons)
    pairs = arms_and_legs(joints)
    if pairs is None:
        return returned
    limbs = [list(joints.indices(tuple(name for name in _FACE if name in joints.names)))]
    limbs += [list(part) for pair in pairs for limb in (pair.left, pair.right) for part in (limb[:1], limb[1:])]
    limbs = [limb for limb in limbs if limb]
    for _ in range(_NUM_ROUNDS):
        parts = [np.array(part, int) for part in _taken(returned, limbs, cameras, timebase, joints, min_score) if part]
        if not parts:
            break
        returned = _give_back(returned, np.concatenate(parts), cameras, timebase, min_score)
    return returned


def _taken(
    persons: Sequence[Person],
    limbs: Sequence[list[int]],
    cameras: Sequence[Camera],
    timebase: Timebase,
    joints: JointSet,
    min_score: float,
) -> Iterator[list[tuple[int, ...]]]:
    """Find the joints of all observations that show a neighbour, as ``_give_back`` takes them."""
    if len(persons) < 2:
        return
    sides = np.array([range(len(joints.names)), joints.indices(tuple(map(other_side, joints.names)))])
    first = min(track.start_frame for track, _ in persons)
    stop = max(track.start_frame + track.num_frames for track, _ in persons)
    margin = int(np.ceil(REACH_S * timebase.frame_rate_hz)) + 2
    for block, frames in _blocks(persons, range(first, stop), margin):
        window = select_window(persons, frames)
        near = near_neighbours(window, cameras)
        near[..., : block.start - frames.start] = False
        near[..., block.stop - frames.start :] = False
        if not near.any():
            continue
        ideal_px = np.stack([undistort_views(cameras, points_px) for points_px in window.points_px])
        for number in np.flatnonzero(near.any((0, 1, 3))).tolist():
            view = _View(window, ideal_px, number, cameras, limbs, sides, min_score)
            affected = view.affected(near[:, :, number])
            for rows in runs(binary_dilation(affected.any((0, 1)), np.ones(2 * margin + 1, bool))):
                expected_m = view.expected_m(affected[..., rows], rows, timebase.frame_rate_hz)
                yield view.taken(affected[..., rows], rows, expected_m, frames[rows].start)


def _blocks(persons: Sequence[Person], whole: range, margin: int) -> Iterator[tuple[range, range]]:
    """Blocks of frames that are worked on at once, each with the frames around that are needed for it."""
    start = whole.start
    while start < whole.stop:
        size = _BLOCK
        while True:
            block = range(start, min(start + size, whole.stop))
            frames = range(max(whole.start, block.start - margin), min(whole.stop, block.stop + margin))
            if size == _MIN_BLOCK or len(present(persons, frames)) ** 2 * len(frames) <= _MAX_PAIRS:
                break
            size //= 2
        yield block, frames
        start = block.stop


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """Everybody's observations in a camera."""

    window: Window
    ideal_px: Float[np.ndarray, "people frames cameras joints 2"]  # Undistorted observations
    number: int  # Position of the camera
    cameras: Sequence[Camera]
    limbs: Sequence[list[int]]
    sides: Int[np.ndarray, "2 joints"]  # Joints of the same and of the other side
    min_score: float

    def affected(self, near: Bool[np.ndarray, "people people frames"]) -> Bool[np.ndarray, "people people frames"]:
        """Frames in which the place of a neighbour may explain a limb: a rough bound, from all views."""
        places_px, px_per_m = self._places(self.window.xyz_m)
        affected = np.zeros_like(near)
        for row in np.flatnonzero(near.any((1, 2))).tolist():
            others = np.flatnonzero(near[row].any(-1))
            is_seen = self._is_seen(row, slice(None))
            unexplained = self._unexplained(row, slice(None), places_px[others], px_per_m[others])
            for limb in self.limbs:
                cost = _means(unexplained[..., limb], is_seen[:, limb])
                may_be_theirs = is_seen[:, limb].any(-1) & (cost.min(1) < 1.0 - _CLEARLY + _ROUGHLY)
                affected[row, others] |= near[row, others] & may_be_theirs
        return affected

    def expected_m(
        self, affected: Bool[np.ndarray, "people people frames"], rows: slice, frame_rate_hz: float
    ) -> Float[np.ndarray, "people frames joints 3"]:
        """Places at which the other views expect the affected people; NaN for the others."""
        involved = affected.any((1, 2)) | affected.any((0, 2))
        expected_m = np.full((len(self.window), rows.stop - rows.start, *self.window.xyz_m.shape[2:]), np.nan)
        for row in np.flatnonzero(involved).tolist():
            seen = self.ideal_px[row, rows], self.window.score[row, rows]
            expected_m[row] = expected_without(*seen, self.number, self.cameras, self.min_score, frame_rate_hz)
        return expected_m

    def taken(
        self,
        affected: Bool[np.ndarray, "people people frames"],
        rows: slice,
        expected_m: Float[np.ndarray, "people frames joints 3"],
        start_frame: int,
    ) -> list[tuple[int, ...]]:
        """Joints of the observations that show a neighbour, as ``_give_back`` takes them."""
        places_px, px_per_m = self._places(expected_m)
        found: list[tuple[int, ...]] = []
        for row in np.flatnonzero(affected.any((1, 2))).tolist():
            others = np.flatnonzero(affected[row].any(-1))
            is_seen = self._is_seen(row, rows)
            counts = is_seen & np.isfinite(places_px[row]).all(-1)
            own = self._unexplained(row, rows, places_px[[row]], px_per_m[[row]])[0].min(0)
            of_others = self._unexplained(row, rows, places_px[others], px_per_m[others])
            of_others = np.where(affected[row][others][:, None, :, None], of_others, 1.0)
            for limb in self.limbs:
                cost = _means(of_others[..., limb], counts[:, limb])
                gain = _means(own[:, limb], counts[:, limb]) - cost.min((0, 1))
                best = cost.reshape(-1, cost.shape[-1]).argmin(0)
                for frame in np.flatnonzero(gain > _CLEARLY):
                    other, side = np.unravel_index(best[frame], cost.shape[:2])
                    joint_gain = own[frame] - of_others[other, side, frame]
                    found += [
                        (
                            start_frame + int(frame),
                            self.number,
                            self.window.person[row],
                            joint,
                            self.window.person[others[other]],
                            int(self.sides[side, joint]),
                        )
                        for joint in limb
                        if is_seen[frame, joint] and joint_gain[joint] > _CLEARLY / 2
                    ]
        return found

    def _places(
        self, xyz_m: Float[np.ndarray, "people frames joints 3"]
    ) -> tuple[Float[np.ndarray, "people frames joints 2"], Float[np.ndarray, "people frames joints"]]:
        """Pixels of joints, and pixels of a metre there."""
        camera = self.cameras[self.number]
        return project(camera, xyz_m), scale_px_per_m(camera, xyz_m)

    def _is_seen(self, row: int, rows: slice) -> Bool[np.ndarray, "frames joints"]:
        score = self.window.score[row, rows, self.number]
        return np.asarray((score > 0) & (score >= self.min_score))

    def _unexplained(
        self,
        row: int,
        rows: slice,
        places_px: Float[np.ndarray, "people frames joints 2"],
        px_per_m: Float[np.ndarray, "people frames joints"],
    ) -> Float[np.ndarray, "people 2 frames joints"]:
        """Share of a person's observation that people's joints of its own and of the other side do not explain.

        It is the function of Geman and McClure of the distance at the joint's depth; 1 for a joint that is not
        expected.
        """
        points_px = self.window.points_px[row, rows, self.number]
        places_px, px_per_m = (
            np.stack([values[:, :, side] for side in self.sides], axis=1) for values in (places_px, px_per_m)
        )
        apart_m = np.linalg.norm(places_px - points_px, axis=-1) / px_per_m
        return np.asarray(np.nan_to_num(apart_m**2 / (apart_m**2 + SCALE_M**2), nan=1.0))


def _means(
    values: Float[np.ndarray, "*batch frames joints"], counts: Bool[np.ndarray, "frames joints"]
) -> Float[np.ndarray, "*batch frames"]:
    """Mean of the joints that count; 0 without any."""
    return np.asarray((counts * values).sum(-1) / np.maximum(counts.sum(-1), 1))


def _give_back(
    persons: Sequence[Person],
    taken: Int[np.ndarray, "taken 6"],
    cameras: Sequence[Camera],
    timebase: Timebase,
    min_score: float,
) -> list[Person]:
    """Take joints from the people who have them, and give them to their owners where these have none.

    ``taken`` has frame, camera, person, joint, owner and owner's joint of each observation of a joint that shows the
    owner, not the person who has it; people are positions in the order of all.
    """
    frame, camera, person, joint, owner, owners_joint = taken.T
    row = frame - np.array([track.start_frame for track, _ in persons])[person]
    given_px, given_score = np.empty((len(row), 2)), np.empty(len(row))
    for k, (_, seen) in enumerate(persons):
        theirs = person == k
        at = row[theirs], camera[theirs], joint[theirs]
        given_px[theirs], given_score[theirs] = seen.points_px[at], seen.score[at]
    returned = list(persons)
    for k in np.union1d(person, owner).tolist():
        track, seen = persons[k]
        points_px, score = large_arrays.copy(seen.points_px), large_arrays.copy(seen.score)
        changed = np.zeros(track.num_frames, bool)
        theirs = person == k
        at = row[theirs], camera[theirs], joint[theirs]
        points_px[at], score[at], changed[at[0]] = np.nan, 0.0, True
        # Of several observations of a joint the first one is given: the last one in the reverse order.
        to_them = np.flatnonzero(owner == k)[::-1]
        at = frame[to_them] - track.start_frame, camera[to_them], owners_joint[to_them]
        lacks = score[at] < max(min_score, np.finfo(float).tiny)
        to_them, at = to_them[lacks], tuple(axis[lacks] for axis in at)
        points_px[at], score[at], changed[at[0]] = given_px[to_them], given_score[to_them], True
        owned = replace(seen, points_px=read_only(points_px), score=read_only(score))
        located, known = relocate((track, owned), changed, cameras, timebase, min_score)
        returned[k] = replace(located, track_id=track.track_id), replace(known, track_id=track.track_id)
    return returned
