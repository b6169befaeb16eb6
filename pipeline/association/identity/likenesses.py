"""Likenesses among the people of a take: people who never move, and mirror images of other people.

``without_likenesses`` removes them from poses of instants, which are linked from instant to instant as far as that
tells who moves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Poses3D, Source, Track3D
from pipeline.core.joints import FINGER_JOINTS, JointSet, other_side
from pipeline.geometry.camera import center_in_world

# Shortest common time, and share of the image's frames in which the person must be known.
_MIN_S, _MIN_SHARE = 2.0, 0.5
_MIN_JOINTS = 6
# Frames from which the plane is found, and their largest median distance: most pairs of people are far from it.
_NUM_SAMPLES, _MAX_COARSE_M = 200, 0.2
# Time over which distances are averaged: noise of positions counts less, motion that is not the same counts as much.
_BLOCK_S = 0.25
# Largest distance of an image's joints from the reflected ones: in the median of a block's joints over the time, and in
# nine blocks of ten.
_MAX_ERROR_M, _MAX_ERROR_90_M = 0.05, 0.1
# Least movement of a quarter of the joints, also as a multiple of that distance: still people tell nothing.
_MIN_MOVED_M, _MIN_MOVED = 0.1, 4.0
# Share of an image's views that cameras behind the mirror may have by mistake.
_MAX_BEHIND = 0.1
_ITERATIONS, _OUTLIER_M = 5, 0.15


@dataclass(frozen=True, slots=True, eq=False)
class MirrorImage:
    """Mirror image of a person."""

    number: int  # Position of the image's track
    original: int  # Position of the person's track
    # Plane of the mirror: points with ``normal @ xyz_m == offset_m``; the normal's largest component is positive
    normal: Float[np.ndarray, " 3"]
    offset_m: float
    error_m: float  # Median distance of the image's joints from the person's reflected ones
    num_frames: int  # Frames in which both were located


@dataclass(frozen=True, slots=True, eq=False)
class Mirror:
    """Plane that reflects a track to another one, and how well it does."""

    normal: Float[np.ndarray, " 3"]
    offset_m: float
    error_m: float


def find_mirror(first: Track3D, second: Track3D, joints: JointSet, frame_rate_hz: float) -> Mirror | None:
    """Find the plane that reflects a person to another one all the time; ``None`` if there is none.

    The normal points to the first person.
    """
    start = max(first.start_frame, second.start_frame)
    stop = min(first.start_frame + first.num_frames, second.start_frame + second.num_frames)
    if stop - start < _MIN_S * frame_rate_hz:
        return None
    body = [name for name in joints.names if name not in FINGER_JOINTS and other_side(name) in joints.names]
    if len(body) < _MIN_JOINTS:
        return None
    columns = np.array(joints.indices(tuple(body)))
    others = np.array(joints.indices(tuple(other_side(name) for name in body)))

    def at(frames: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Joints of the person, with left and right exchanged, and of the image in frames in which both are known."""
        person_m = first.xyz_m[frames - first.start_frame][:, others]
        image_m = second.xyz_m[frames - second.start_frame][:, columns]
        known = (np.isfinite(person_m[..., 0]) & np.isfinite(image_m[..., 0])).sum(-1) >= _MIN_JOINTS
        return person_m[known], image_m[known]

    step = -(-(stop - start) // _NUM_SAMPLES)
    person_m, image_m = at(np.arange(start, stop, step))
    if len(person_m) * step < _MIN_S * frame_rate_hz:
        return None
    normal, offset_m = _fit_plane(person_m.reshape(-1, 3), image_m.reshape(-1, 3))
    if not np.nanmedian(_error_m(person_m, image_m, normal, offset_m)) <= _MAX_COARSE_M:
        return None
    person_m, image_m = at(np.arange(start, stop))
    block = max(1, round(_BLOCK_S * frame_rate_hz))
    shape = (-1, block, *person_m.shape[1:])
    whole = slice(len(person_m) // block * block)
    error_m = _error_m(person_m[whole].reshape(shape), image_m[whole].reshape(shape), normal, offset_m)
    error_m = np.nanmedian(error_m, axis=-1)
    usual_m, high_m = float(np.median(error_m)), float(np.quantile(error_m, 0.9))
    if (
        usual_m > _MAX_ERROR_M
        or high_m > _MAX_ERROR_90_M
        or _moved_m(person_m) < max(_MIN_MOVED_M, _MIN_MOVED * usual_m)
    ):
        return None
    return Mirror(normal, offset_m, usual_m)


def _error_m(
    person_m: Float[np.ndarray, "*batch joints 3"],
    image_m: Float[np.ndarray, "*batch joints 3"],
    normal: Float[np.ndarray, " 3"],
    offset_m: float,
) -> Float[np.ndarray, "blocks joints"]:
    """Distance of an image's joints from the reflected ones, of frames or of blocks of frames; NaN if unknown."""
    away_m = image_m - _reflect(person_m, normal, offset_m)
    known = np.isfinite(away_m)
    if away_m.ndim > 3:
        count = known.sum(1)
        away_m = np.where(known, away_m, 0.0).sum(1) / np.where(count > 0, count, np.nan)
    return np.asarray(np.linalg.norm(away_m, axis=-1))


def _reflect(
    xyz_m: Float[np.ndarray, "*batch 3"], normal: Float[np.ndarray, " 3"], offset_m: float
) -> Float[np.ndarray, "*batch 3"]:
    return np.asarray(xyz_m - 2 * (xyz_m @ normal - offset_m)[..., None] * normal)


def is_image(
    mirror: Mirror,
    behind: Track3D,
    cameras_m: Float[np.ndarray, "cameras 3"],
    sees: Bool[np.ndarray, "frames cameras"],
    num_common: int,
) -> bool:
    """Tell whether the person on the far side of a plane is an image: all cameras that see it are on the near side.

    ``sees`` is whether a camera saw any joint in a frame of the track ``behind``; ``num_common`` are frames that it
    shares with the person.
    """
    if num_common < _MIN_SHARE * np.isfinite(behind.xyz_m[..., 0]).any(-1).sum():
        return False
    is_behind = cameras_m @ mirror.normal < mirror.offset_m
    views = sees.sum(0)
    return bool(views.sum() > 0 and views[is_behind].sum() <= _MAX_BEHIND * views.sum())


def _fit_plane(
    person_m: Float[np.ndarray, "points 3"], image_m: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """Plane half-way between points and their images, robustly; its normal points to the first ones."""
    known = np.isfinite(person_m).all(-1) & np.isfinite(image_m).all(-1)
    person_m, image_m = person_m[known], image_m[known]
    between_m, middle_m = person_m - image_m, (person_m + image_m) / 2
    normal = np.median(between_m, axis=0)
    used = np.ones(len(between_m), bool)
    for _ in range(_ITERATIONS):
        _, _, axes = np.linalg.svd(between_m[used], full_matrices=False)
        normal = axes[0] * (np.sign(axes[0] @ normal) or 1.0)
        offset_m = float(np.median(middle_m[used] @ normal))
        error_m = np.linalg.norm(image_m - _reflect(person_m, normal, offset_m), axis=-1)
        used = error_m <= max(_OUTLIER_M, float(np.median(error_m)))
    return normal, offset_m


def _moved_m(person_m: Float[np.ndarray, "frames joints 3"]) -> float:
    """Movement of the liveliest quarter of a person's located joints: distance from their usual places."""
    person_m = person_m[:, np.isfinite(person_m[..., 0]).any(0)]
    away_m = np.linalg.norm(person_m - np.nanmedian(person_m, axis=0), axis=-1)
    return float(np.nanquantile(np.nanquantile(away_m, 0.9, axis=0), 0.75))


# Shortest time and fewest joints of which something is said.
_MIN_STILL_S, _MIN_STILL_JOINTS = 3.0, 8
_STILL_BLOCK_S = 0.5
# Blocks of a long take, evenly spread.
_MAX_BLOCKS = 600
# Share of the frames of a block, and of the blocks, in which a joint must be known.
_MIN_STILL_SHARE = 0.5
# Share of the blocks in which a joint must be near its usual place, and of the joints: bodies that pass in front are
# mixed up.
_BLOCKS, _JOINTS = 0.9, 0.9
# Largest movement of what never moves, beside the noise: so many standard deviations of a block's median, which errors
# of a detector that last for some time make larger.
_MAX_MOVED_M, _NUM_SIGMAS, _ERROR_LASTS_S = 0.015, 3.0, 0.1
# Noise in which no movement would be seen.
_MAX_NOISE_M = 0.04
# Way of half of the joints, in any block, after which a person has moved.
_GONE_M = 0.2


@dataclass(frozen=True, slots=True)
class StillPerson:
    """Person or thing that never moves."""

    number: int  # Position of the track
    # Distance of joints from their usual places that nine tenths of the take do not exceed; the largest of them
    moved_m: float
    num_frames: int  # Frames in which joints were located


def find_still(number: int, track: Track3D, joints: JointSet, frame_rate_hz: float) -> StillPerson | None:
    """Tell whether a person never moves; ``None`` for people who do, and where too little is known.

    ``number`` is the position of the track. Positions are those that association located, without smoothing.
    """
    body = [index for index, name in enumerate(joints.names) if name not in FINGER_JOINTS]
    rows = np.flatnonzero(np.isfinite(track.xyz_m[..., 0]).any(-1))
    block = max(2, round(_STILL_BLOCK_S * frame_rate_hz))  # noise is measured between neighbouring frames
    if len(rows) < max(_MIN_STILL_S * frame_rate_hz, block):
        return None
    blocks = rows[: len(rows) // block * block].reshape(-1, block)
    xyz_m = track.xyz_m[blocks[:: -(-len(blocks) // _MAX_BLOCKS)]][:, :, body]
    places_m = _medians(xyz_m)
    often = np.isfinite(places_m[..., 0]).mean(0) >= _MIN_STILL_SHARE
    if np.count_nonzero(often) < _MIN_STILL_JOINTS:
        return None
    places_m = places_m[:, often]
    away_m = np.linalg.norm(places_m - np.nanmedian(places_m, axis=0), axis=-1)
    moved_m = np.nanquantile(away_m, _BLOCKS, axis=0)
    num_errors = max(1.0, _STILL_BLOCK_S / max(_ERROR_LASTS_S, 1.0 / frame_rate_hz))
    noise_m = _NUM_SIGMAS * _sigma_m(xyz_m[:, :, often]) / np.sqrt(num_errors)
    is_still = (noise_m <= _MAX_NOISE_M) & (moved_m <= np.hypot(_MAX_MOVED_M, noise_m))
    if is_still.mean() < _JOINTS or _median_of_joints(away_m).max() > _GONE_M:
        return None
    return StillPerson(number, float(moved_m[is_still].max()), len(rows))


def _median_of_joints(away_m: Float[np.ndarray, "blocks joints"]) -> Float[np.ndarray, " blocks"]:
    """Median distance of the known joints of each block that has any."""
    return np.asarray(np.nanmedian(away_m[np.isfinite(away_m).any(-1)], axis=-1))


def _medians(blocks_m: Float[np.ndarray, "blocks frames joints 3"]) -> Float[np.ndarray, "blocks joints 3"]:
    """Median place of each joint in each block; NaN where it is known too seldom."""
    in_order_m = np.sort(blocks_m, axis=1)  # NaN comes last
    count = np.isfinite(blocks_m).sum(1, keepdims=True)
    middle_m = np.take_along_axis(in_order_m, np.maximum(count - 1, 0) // 2, axis=1)[:, 0]
    return np.where(count[:, 0] >= _MIN_STILL_SHARE * blocks_m.shape[1], middle_m, np.nan)


def _sigma_m(blocks_m: Float[np.ndarray, "blocks frames joints 3"]) -> Float[np.ndarray, " joints"]:
    """Standard deviation of each joint along its noisiest axis, from differences of neighbouring frames.

    Infinite for a joint that no two neighbouring frames know.
    """
    change_m = np.abs(np.diff(blocks_m, axis=1))
    change_m = change_m.reshape(-1, *change_m.shape[2:])
    sigma_m = np.full(change_m.shape[1], np.inf)
    known = np.isfinite(change_m).any((0, 2))
    sigma_m[known] = np.nanmedian(change_m[:, known], axis=0).max(-1) / 0.6745 / np.sqrt(2.0)
    return sigma_m


Sees = Callable[[int], Bool[np.ndarray, "frames cameras"]]
"""Returns the frames in which each camera saw a person, by the position of the track."""


@dataclass(frozen=True, slots=True)
class Likenesses:
    """People of a take who may be none."""

    still: Sequence[StillPerson] = ()  # Those who never move
    images: Sequence[MirrorImage] = ()  # Mirror images of others

    @property
    def numbers(self) -> frozenset[int]:
        """Positions of their tracks."""
        return frozenset([*(person.number for person in self.still), *(image.number for image in self.images)])

    def others(self, num_people: int) -> Sequence[int]:
        """Positions of the tracks of all others, used to judge floor and cameras; everybody's without any."""
        return [number for number in range(num_people) if number not in self.numbers] or list(range(num_people))


def find_likenesses(
    tracks: Sequence[Track3D], sees: Sees, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float
) -> Likenesses:
    """Find who never moves, and who is another person's mirror image.

    Tracks are as association located them. The mirror image of a person who never moves never moves either.
    """
    kept = list(tracks)
    found = (find_still(number, track, joints, frame_rate_hz) for number, track in enumerate(kept))
    still = [person for person in found if person is not None]
    moving = [number for number in range(len(kept)) if number not in {person.number for person in still}]
    cameras_m = np.array([center_in_world(camera) for camera in cameras])
    images: dict[int, MirrorImage] = {}
    for place, first in enumerate(moving):
        for second in moving[place + 1 :]:
            mirror = find_mirror(kept[first], kept[second], joints, frame_rate_hz)
            if mirror is None:
                continue
            for image, original, plane in (
                (second, first, mirror),
                (first, second, Mirror(-mirror.normal, -mirror.offset_m, mirror.error_m)),
            ):
                num_common = _num_common(kept[first], kept[second])
                if is_image(plane, kept[image], cameras_m, sees(image), num_common):
                    sign = float(np.sign(plane.normal[np.argmax(np.abs(plane.normal))]))
                    normal, offset_m = read_only(sign * plane.normal), sign * plane.offset_m
                    candidate = MirrorImage(image, original, normal, offset_m, plane.error_m, num_common)
                    if image not in images or candidate.num_frames > images[image].num_frames:
                        images[image] = candidate
    return Likenesses(still, [images[number] for number in sorted(images)])


def seen_in(observations: Sequence[Observations]) -> Sees:
    """Frames in which each camera saw any joint of a person."""
    return lambda number: np.asarray((observations[number].score > 0.0).any(-1))


def _num_common(first: Track3D, second: Track3D) -> int:
    """Number of frames in which both people were located."""
    start = max(first.start_frame, second.start_frame)
    stop = min(first.start_frame + first.num_frames, second.start_frame + second.num_frames)
    located = [
        np.isfinite(track.xyz_m[start - track.start_frame : stop - track.start_frame, :, 0]).any(-1)
        for track in (first, second)
    ]
    return int(np.count_nonzero(located[0] & located[1]))


# Farthest way of a body from one instant to the next one, and longest absence.
_REACH_M, _ABSENT_S = 0.6, 2.0


def without_likenesses(
    poses: Sequence[Poses3D], cameras: Sequence[Camera], joints: JointSet, timebase: Timebase, step: int
) -> list[Poses3D]:
    """Leave out the poses of those who never move and of mirror images; all stay if no other person is left.

    ``poses`` are parts of a take at every ``step``-th output frame, in any order, such as one a person.
    """
    frame = np.concatenate([np.zeros(0, int), *(some.frame for some in poses)])
    if not len(frame):
        return list(poses)
    xyz_m = np.concatenate([some.xyz_m for some in poses])
    sees = np.concatenate([np.isfinite(some.points_px[..., 0]).any(1) for some in poses])
    rate_hz = timebase.frame_rate_hz / step
    chains = _link(frame, xyz_m, round(_ABSENT_S * timebase.frame_rate_hz))
    tracks = [_instants_track(frame[rows] // step, xyz_m[rows]) for rows in chains]

    def sees_in(number: int) -> np.ndarray:
        return np.asarray(sees[chains[number]])

    likenesses = find_likenesses(tracks, sees_in, cameras, joints, rate_hz)
    kept = np.zeros(len(frame), bool)
    for number in likenesses.others(len(chains)):
        kept[chains[number]] = True
    parts = np.split(kept, np.cumsum([len(some.frame) for some in poses])[:-1])
    return [
        replace(some, **{name: getattr(some, name)[chosen] for name in ("frame", "xyz_m", "points_px", "score")})
        for some, chosen in zip(poses, parts, strict=True)
    ]


def _link(
    frame: Int[np.ndarray, " poses"], xyz_m: Float[np.ndarray, "poses joints 3"], longest_absence: int
) -> list[Int[np.ndarray, " rows"]]:
    """Rows of the poses of each body, in order of time: each pose goes to the nearest body of the instants before."""
    place_m = _middle_m(xyz_m)
    chains: list[list[int]] = []
    for now in np.unique(frame):
        rows = np.flatnonzero((frame == now) & np.isfinite(place_m[:, 0]))
        alive = [chain for chain in chains if now - frame[chain[-1]] <= longest_absence]
        last_m = np.array([place_m[chain[-1]] for chain in alive]).reshape(-1, 3)
        away_m = np.linalg.norm(last_m[:, None] - place_m[rows][None], axis=-1)
        taken = set()
        for chain, column in zip(*linear_sum_assignment(np.minimum(away_m, 2 * _REACH_M)), strict=True):
            if away_m[chain, column] <= _REACH_M:
                alive[chain].append(int(rows[column]))
                taken.add(int(column))
        chains += [[int(row)] for column, row in enumerate(rows) if column not in taken]
    return [np.array(chain) for chain in chains]


def _middle_m(xyz_m: Float[np.ndarray, "poses joints 3"]) -> Float[np.ndarray, "poses 3"]:
    """Median of the known joints of each pose; NaN without any."""
    middle_m = np.full((len(xyz_m), 3), np.nan)
    known = np.isfinite(xyz_m[..., 0]).any(-1)
    if known.any():
        middle_m[known] = np.nanmedian(xyz_m[known], axis=1)
    return middle_m


def _instants_track(instant: Int[np.ndarray, " rows"], xyz_m: Float[np.ndarray, "rows joints 3"]) -> Track3D:
    """Track of the poses of one body, by instants."""
    num = int(instant[-1] - instant[0]) + 1
    all_m = np.full((num, *xyz_m.shape[1:]), np.nan)
    all_m[instant - instant[0]] = xyz_m
    known = np.isfinite(all_m[..., 0])
    return Track3D(
        0,
        int(instant[0]),
        all_m,
        known.astype(np.float64),
        np.where(known, Source.MEASURED, Source.ABSENT),
        np.where(known, 0.0, np.nan),
        known.astype(int),
    )
