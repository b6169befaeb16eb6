"""Paths of the markers of a person, from the fitted skeleton and the final joints."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.export.opensim.anatomy import MARKERS, BoneMarker, CentreMarker, SeenMarker
from pipeline.export.opensim.scaling import ModelSize
from pipeline.motion.angles.compute import observed, segments_from
from pipeline.motion.skeleton.model import INDEX, forward_kinematics

# Frames that are worked on at once, so that a long take needs little memory.
_BLOCK_FRAMES = 2048


@dataclass(frozen=True, slots=True, eq=False)
class MarkerPaths:
    """Paths of markers in the frames in which the pelvis is known."""

    names: tuple[str, ...]  # Markers that are ever known
    frames: Int[np.ndarray, " frames"]  # Output frame of each row, ascending, with gaps
    # Positions from an origin in world axes, NaN where a marker is unknown
    xyz_m: Float[np.ndarray, "frames markers 3"]


def marker_paths(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, size: ModelSize, origin_m: Float[np.ndarray, " 3"]
) -> MarkerPaths:
    """Paths of all markers of ``MARKERS`` that a person shows.

    Frames without a known pelvis are left out: OpenSim stops at a frame without any marker, and the model hangs on its
    pelvis. ``origin_m`` is the world position that is their origin.
    """
    blocks, of_pelvis = [], []
    for start in range(0, track.num_frames, _BLOCK_FRAMES):
        rows = slice(start, start + _BLOCK_FRAMES)
        part = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
        seen = replace(track, xyz_m=track.xyz_m[rows], source=track.source[rows], uncertainty_m=None)
        block_m, is_known = _markers_m(part, seen, joints, size)
        blocks.append(block_m[is_known])
        of_pelvis.append(is_known)
    xyz_m = np.concatenate(blocks)
    is_shown = np.isfinite(xyz_m).all(-1).any(0)
    names = tuple(name for name, shown in zip(MARKERS, is_shown, strict=True) if shown)
    frames = track.start_frame + np.flatnonzero(np.concatenate(of_pelvis))
    return MarkerPaths(names, frames, xyz_m[:, is_shown] - origin_m)


def _markers_m(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, size: ModelSize
) -> tuple[Float[np.ndarray, "frames markers 3"], np.ndarray]:
    """World positions of all markers in some frames, and in which of them the pelvis is known."""
    positions_m, world_from_segment, known = forward_kinematics(motion), segments_from(motion), observed(track, joints)
    xyz_m = np.full((track.num_frames, len(MARKERS), 3), np.nan)
    for number, marker in enumerate(MARKERS.values()):
        match marker:
            case CentreMarker(joint=joint, landmark=landmark) if landmark in joints.names:
                is_known = np.isfinite(track.xyz_m[:, joints.index(landmark)]).all(-1)
                xyz_m[is_known, number] = positions_m[is_known, INDEX[joint]]
            case BoneMarker(segment=segment, joint=joint, offset_m=offset_m):
                offset = np.array(offset_m) * size.factors[marker.body]
                place_m = positions_m[:, INDEX[joint]] + world_from_segment[segment] @ offset
                xyz_m[known[segment], number] = place_m[known[segment]]
            case SeenMarker(landmark=landmark, segment=segment) if landmark in joints.names:
                # Fingers that nobody saw rest in a pose of the model.
                is_known = known[segment] if segment.endswith("_hand") else np.ones(track.num_frames, bool)
                xyz_m[is_known, number] = track.xyz_m[is_known, joints.index(landmark)]
    return xyz_m, known["pelvis"]
