"""Evidence of a person after corrections: observations that are ignored, moved or exchanged, and located joints."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import JointSet, other_side
from pipeline.core.options.corrections import joints_of_part, joints_of_sides
from pipeline.core.options.edits import Correction, ExchangeSides, IgnoreDetections, PlaceDetection, frames_of
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.triangulation import triangulate_robust
from pipeline.geometry.undistortion import undistort_views
from pipeline.motion.skeleton.corrections.keys import rows_between

# Score with which the fit weighs a detection that was placed by hand: 27 times a sure one of the detector.
_PLACED_SCORE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedEvidence:
    """Located joints and observations of a person after corrections."""

    located: Track3D
    seen: Observations
    is_placed: Bool[np.ndarray, "frames cameras joints"]  # Observations that were placed by hand
    is_changed: Bool[np.ndarray, "frames joints"]  # Joints with other observations

    @property
    def weighted(self) -> Observations:
        """Observations with the scores by which the fit weighs them."""
        return replace(self.seen, score=np.where(self.is_placed, _PLACED_SCORE, self.seen.score))


def corrected_evidence(
    located: Track3D,
    seen: Observations,
    corrections: Sequence[Correction],
    cameras: Sequence[Camera],
    joints: JointSet,
) -> CorrectedEvidence:
    """Apply the corrections of observations in their order; keys and contacts change no observation.

    Where observations were ignored or placed, the joint is located again by the remaining ones. It is absent where
    fewer than two cameras see it: the fit bridges short gaps.

    ``located``, ``seen``: joints as association located them, world positions in metres, NaN where absent, and their
    observations in distorted pixels, NaN with score 0 where there is none. ``corrections``: frames outside of the
    track, cameras and joints that the take lacks are ignored.
    """
    arrays = {name: np.array(array) for name, array in located.joint_arrays.items()}
    points_px, score = np.array(seen.points_px), np.array(seen.score)
    is_placed, is_moved = np.zeros(score.shape, bool), np.zeros(score[:, 0].shape, bool)
    is_changed = np.zeros(score[:, 0].shape, bool)
    names = [camera.name for camera in cameras]

    for correction in corrections:
        here = rows_between(*frames_of(correction), located.start_frame, len(score))
        match correction:
            case ExchangeSides():
                mine = [
                    name for name in joints_of_sides(correction.part, joints.names) if other_side(name) in joints.names
                ]
                columns, others = joints.indices(tuple(mine)), joints.indices(tuple(map(other_side, mine)))
                if correction.left_m is not None and here.start < here.stop:
                    lefts = np.array([name.startswith("left") for name in mine])
                    xyz_m = arrays["xyz_m"][here.start, columns]
                    away_m = np.linalg.norm(xyz_m - correction.left_m, axis=-1)
                    left_m, right_m = (away_m[of_side & np.isfinite(away_m)] for of_side in (lefts, ~lefts))
                    if len(left_m) and len(right_m) and left_m.mean() < right_m.mean():
                        continue  # this run has the sides right
                for array in (points_px, score, is_placed):
                    array[here, :, columns] = array[here, :, others]
                for array in (*arrays.values(), is_moved):
                    array[here, columns] = array[here, others]
                is_changed[here, columns] = True
            case IgnoreDetections() if correction.camera in names:
                camera, columns = (
                    names.index(correction.camera),
                    joints.indices(tuple(joints_of_part(correction.part, joints.names))),
                )
                points_px[here, camera, columns], score[here, camera, columns] = np.nan, 0.0
                is_placed[here, camera, columns] = False
                is_moved[here, columns] = is_changed[here, columns] = True
            case PlaceDetection() if correction.camera in names and correction.joint in joints.names:
                camera, column = names.index(correction.camera), joints.index(correction.joint)
                points_px[here, camera, column], score[here, camera, column] = correction.place_px, 1.0
                is_placed[here, camera, column] = is_moved[here, column] = is_changed[here, column] = True
    found = replace(seen, points_px=read_only(points_px), score=read_only(score))
    evidence = CorrectedEvidence(located, found, is_placed, is_changed)
    _locate(arrays, evidence.weighted, is_moved, cameras)
    final: dict[str, Any] = {name: read_only(array) for name, array in arrays.items()}
    return replace(evidence, located=replace(located, **final))


def _locate(
    arrays: dict[str, np.ndarray],
    seen: Observations,
    is_moved: Bool[np.ndarray, "frames joints"],
    cameras: Sequence[Camera],
) -> None:
    """Locate joints again where their observations changed, in place."""
    here = is_moved.any(1)
    if not here.any():
        return
    is_moved, score = is_moved[here], seen.score[here]
    ideal_px = undistort_views(cameras, seen.points_px[here])
    xyz_m = triangulate_robust(projection_matrices(cameras), ideal_px, score)
    views = (score > 0).sum(1)
    is_known = np.isfinite(xyz_m).all(-1)
    new: dict[str, Float[np.ndarray, "rows joints *values"]] = {
        "xyz_m": xyz_m,
        "score": np.where(is_known, np.minimum(score, 1.0).sum(1) / np.maximum(views, 1), 0.0),
        "source": np.where(is_known, Source.MEASURED, Source.ABSENT),
        "views": np.where(is_known, views, 0),
        "error_px": np.full(is_known.shape, np.nan),
        "uncertainty_m": np.full(is_known.shape, np.nan),
    }
    for name, array in arrays.items():
        moved = is_moved.reshape(*is_moved.shape, *(1,) * (array.ndim - 2))
        array[here] = np.where(moved, new[name], array[here])
