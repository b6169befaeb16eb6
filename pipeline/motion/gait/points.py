"""Points of a person's body that gait and movement are read from, on the ground that the feet stand on."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.balance.segment_masses import segment_masses
from pipeline.motion.skeleton.feet.support import FootMarks, belt_m

_BODY = tuple(f"{side}_{kind}" for kind in ("ankle", "knee", "hip") for side in SIDES)
# Share of the frames with a known ankle in which heel and toe must be known, so that events are theirs.
_KNOWN_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points of a person in each frame of a track; sides are left and right.

    Positions are relative to the ground: on a treadmill the person walks ahead. Unknown frames are filled from their
    neighbours and marked.
    """

    frame_rate_hz: float
    # Marks of the feet; the ankles where heel and toe were not seen
    heels_m: Float[np.ndarray, "frames 2 3"]
    toes_m: Float[np.ndarray, "frames 2 3"]
    ankles_m: Float[np.ndarray, "frames 2 3"]
    knees_m: Float[np.ndarray, "frames 2 3"]
    hips_m: Float[np.ndarray, "frames 2 3"]
    mass_m: Float[np.ndarray, "frames 3"]  # Centre of mass of a body of the mean of both sexes
    is_marked: Bool[np.ndarray, " 2"]  # Feet whose heels and toes were seen
    known: Bool[np.ndarray, "frames 2"]  # Frames in which the points of a leg have a position
    measured: Bool[np.ndarray, "frames 2"]  # Frames in which the points of a foot were measured
    belt_m_s: Float[np.ndarray, " 2"]  # Velocity of the treadmill's belt; zeros without one

    @property
    def num_frames(self) -> int:
        """Number of frames of the track."""
        return len(self.heels_m)

    @cached_property
    def centre_m(self) -> Float[np.ndarray, "frames 3"]:
        """Centre between the hips."""
        return np.asarray(self.hips_m.mean(1))

    @cached_property
    def leg_m(self) -> float:
        """Length of a straight leg from hip to ankle: median of thigh and shin."""
        thigh_m = np.linalg.norm(self.hips_m - self.knees_m, axis=-1)
        shin_m = np.linalg.norm(self.knees_m - self.ankles_m, axis=-1)
        return float(np.median((thigh_m + shin_m)[self.known]))

    @cached_property
    def lowest_m(self) -> Float[np.ndarray, "frames 2"]:
        """Height of each foot's lower mark above its own standing height."""
        low_m = np.minimum(self.heels_m[..., 2], self.toes_m[..., 2])
        return np.asarray(low_m - np.quantile(low_m[self.known.all(1)], 0.1, axis=0))


def body_points(track: Track3D, joints: JointSet, frame_rate_hz: float) -> BodyPoints | None:
    """Gather the points of a person's track; ``None`` without legs, or if they are known in fewer than two frames."""
    if not set(_BODY) <= set(joints.names):
        return None

    def positions_m(kind: str) -> Float[np.ndarray, "frames 2 3"]:
        columns = joints.indices(tuple(f"{side}_{kind}" for side in SIDES))
        return np.array(track.xyz_m[:, columns], dtype=float)

    ankles_m, knees_m, hips_m = (positions_m(kind) for kind in ("ankle", "knee", "hip"))
    legs_m = np.stack([ankles_m, knees_m, hips_m], axis=2)
    known = np.isfinite(legs_m).all((2, 3))
    masses = segment_masses(Subject(), joints, track.xyz_m)
    if masses is None or known.all(1).sum() < 2:
        return None
    columns = joints.indices(tuple(f"{side}_ankle" for side in SIDES))
    measured = known & (track.source[:, columns] == Source.MEASURED)
    heels_m, toes_m, is_marked = ankles_m, ankles_m, np.zeros(2, dtype=bool)
    foot_marks = None
    marks = tuple(f"{side}_{mark}" for mark in ("heel", "big_toe") for side in SIDES)
    if set(marks) <= set(joints.names):
        found_m = positions_m("heel"), positions_m("big_toe")
        has_marks = np.isfinite(np.stack(found_m)).all((0, 3))
        is_marked = has_marks.sum(0) >= np.maximum(_KNOWN_SHARE * known.sum(0), 1.0)
        heels_m, toes_m = (np.where(is_marked[:, None], points_m, ankles_m) for points_m in found_m)
        sources = track.source[:, joints.indices(marks)].reshape(-1, 2, 2)
        measured &= (sources == Source.MEASURED).all(1) | ~is_marked
        marks_m = np.concatenate(found_m, axis=1)
        foot_marks = FootMarks(_filled(marks_m), np.isfinite(marks_m).all(-1) & np.tile(is_marked, 2))
    way_m = belt_m(_filled(ankles_m), known, _filled(hips_m).mean(1), frame_rate_hz, foot_marks)
    heels_m, toes_m, ankles_m, knees_m, hips_m = (
        _filled(points_m) - way_m[:, None] for points_m in (heels_m, toes_m, ankles_m, knees_m, hips_m)
    )
    # Weights in a sum of 1; fingers, and joints that are never known, have none.
    weights = masses.weights[: track.xyz_m.shape[1]] * np.isfinite(track.xyz_m).all(-1).any(0)
    mass_m = np.einsum("j,fjk->fk", weights / weights.sum(), _filled(np.array(track.xyz_m, dtype=float))) - way_m
    belt_m_s = way_m[-1, :2] / (len(way_m) - 1) * frame_rate_hz
    return BodyPoints(
        frame_rate_hz,
        heels_m,
        toes_m,
        ankles_m,
        knees_m,
        hips_m,
        mass_m,
        np.asarray(is_marked),
        known,
        measured,
        belt_m_s,
    )


def _filled(points_m: Float[np.ndarray, "frames *points 3"]) -> Float[np.ndarray, "frames *points 3"]:
    """Positions with unknown frames interpolated from known ones; zeros for points that are never known."""
    filled_m = np.array(points_m, order="C")  # In another order, the columns below are a copy
    flat = filled_m.reshape(len(filled_m), -1)
    rows = np.arange(len(flat))
    for column in flat.T:
        is_known = np.isfinite(column)
        column[:] = np.interp(rows, rows[is_known], column[is_known]) if is_known.any() else 0.0
    return filled_m
