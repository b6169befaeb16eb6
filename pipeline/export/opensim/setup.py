"""Scaled models of OpenSim: their scaling, their markers, and the setups of its tools."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet
from pipeline.export.opensim import anatomy
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import fixed, frame_blocks
from pipeline.export.writers.trc import head
from pipeline.motion.angles.compute import observed, segments_from
from pipeline.motion.forces.body_mass import body_mass, stature_m
from pipeline.motion.skeleton.model import INDEX, TRUNK, forward_kinematics

SMALLEST, LARGEST = 0.25, 3.0
"""Factors of a body outside of which a person's bone can't be right."""
# Rows that places of markers are the median of.
_MAX_ROWS = 2000


@dataclass(frozen=True, slots=True)
class ModelSize:
    """Size of a person's model."""

    stature_m: float  # Stature by the lengths of legs and trunk
    mass_kg: float  # Mass, stated or by the stature
    factors: Mapping[str, anatomy.Place]  # Factors of each body along its axes X, Y and Z
    places_m: Mapping[str, anatomy.Place]  # Place of each marker in the body of the generic model, before it is scaled

    @property
    def odd_bodies(self) -> tuple[str, ...]:
        """Bodies whose size can't be right."""
        return tuple(
            body
            for body, factors in self.factors.items()
            if not all(SMALLEST <= factor <= LARGEST for factor in factors)
        )


def model_size(motion: SkeletonMotion, track: Track3D, joints: JointSet, subject: Subject) -> ModelSize:
    """Size of a person's model.

    Limbs have the lengths of the skeleton's bones. The pelvis is as wide as the hips, and the width and
    depth of the torso follow the shoulders. Markers of feet and head stand where the person has them: at their median
    place beside the bone. The mass is stated or by stature, and is shared among bodies as in the generic model.
    """
    height_m = stature_m(motion)
    factors = _factors(motion, track, joints, height_m)
    return ModelSize(height_m, body_mass(subject, motion).kg, factors, _places_m(motion, track, joints, factors))


def _length_m(motion: SkeletonMotion, *names: str) -> float:
    """Mean length of bones, which have the name of the joint at their end."""
    return float(np.mean([motion.bone_length_m[INDEX[name]] for name in names]))


def _of_both(motion: SkeletonMotion, joint: str) -> float:
    return _length_m(motion, f"Left{joint}", f"Right{joint}")


def _trunk_m(motion: SkeletonMotion) -> float:
    return sum(_length_m(motion, name) for name in TRUNK)


def _factors(motion: SkeletonMotion, track: Track3D, joints: JointSet, stature_m: float) -> dict[str, anatomy.Place]:
    whole = stature_m / anatomy.STATURE_M
    hips, shoulders = (
        _of_both(motion, "UpLeg") / anatomy.HALF_HIPS_M,
        _of_both(motion, "Arm") / anatomy.HALF_SHOULDERS_M,
    )
    limbs = {
        ("femur",): _of_both(motion, "Leg") / anatomy.THIGH_M,
        ("tibia",): _of_both(motion, "Foot") / anatomy.SHANK_M,
        ("humerus",): _of_both(motion, "ForeArm") / anatomy.UPPER_ARM_M,
        ("ulna", "radius", "hand"): _of_both(motion, "Hand") / anatomy.FOREARM_M,
    }
    foot = _foot_factor(track, joints, whole)
    # The trunk is as long as the pelvis, up to the lumbar joint, and the torso from there.
    back_m = whole * (anatomy.LUMBAR[0] - anatomy.HIPS[0]) + shoulders * anatomy.SHOULDERS[0]
    up_m = np.sqrt(max(_trunk_m(motion) ** 2 - back_m**2, 0.0)) - whole * (anatomy.LUMBAR[1] - anatomy.HIPS[1])
    return {
        **dict.fromkeys(("pelvis", "sacrum"), (whole, whole, hips)),
        "torso": (shoulders, float(up_m / anatomy.SHOULDERS[1]), shoulders),
        "head": (whole, whole, whole),
        **{
            f"{body}_{side[0]}": (factor, factor, factor)
            for side in SIDES
            for bodies, factor in limbs.items()
            for body in bodies
        },
        **{body: (foot, foot, foot) for side in SIDES for body in anatomy.FEET[side]},
    }


def _foot_factor(track: Track3D, joints: JointSet, otherwise: float) -> float:
    """Factor of the feet by the distance of heel and big toe, where both are known."""
    apart_m = []
    for side in SIDES:
        ends = (f"{side}_heel", f"{side}_big_toe")
        if set(ends) <= set(joints.names):
            heel_m, toe_m = (track.xyz_m[:, joints.index(name)] for name in ends)
            apart_m.append(np.linalg.norm(toe_m - heel_m, axis=-1))
    known_m = np.concatenate(apart_m) if apart_m else np.empty(0)
    known_m = known_m[np.isfinite(known_m)]
    return float(np.median(known_m)) / anatomy.FOOT_M if len(known_m) else otherwise


def _places_m(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, factors: Mapping[str, anatomy.Place]
) -> dict[str, anatomy.Place]:
    rows = np.unique(np.linspace(0, track.num_frames - 1, min(track.num_frames, _MAX_ROWS)).astype(int))
    motion = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    part = replace(track, xyz_m=track.xyz_m[rows], source=track.source[rows], uncertainty_m=None)
    positions_m, world_from_segment, known = forward_kinematics(motion), segments_from(motion), observed(part, joints)
    places = {}
    for name, marker in anatomy.MARKERS.items():
        places[name] = marker.place_m
        if (
            isinstance(marker, anatomy.SeenMarker)
            and marker.landmark in joints.names
            and not marker.segment.endswith("_hand")
        ):
            joint = "Head" if marker.segment == "head" else f"{marker.segment.partition('_')[0].capitalize()}Foot"
            away_m = part.xyz_m[:, joints.index(marker.landmark)] - positions_m[:, INDEX[joint]]
            beside_m = np.einsum("fji,fj->fi", world_from_segment[marker.segment], away_m)
            beside_m = beside_m[known[marker.segment] & np.isfinite(beside_m).all(1)]
            if len(beside_m):
                origin_m = _head_m(motion, factors) if joint == "Head" else _ankle_m(marker.segment, factors)
                place_m = (np.median(beside_m, axis=0) + origin_m) / factors[marker.body]
                places[name] = (float(place_m[0]), float(place_m[1]), float(place_m[2]))
    return places


def _head_m(motion: SkeletonMotion, factors: Mapping[str, anatomy.Place]) -> Float[np.ndarray, " 3"]:
    """Place of the skeleton's head in the scaled model's head, of a person who looks straight ahead."""
    neck_m = (np.array(anatomy.NECK) - anatomy.SHOULDERS) * factors["torso"]
    return np.array([0.0, _length_m(motion, "Head"), 0.0]) - neck_m + np.array(anatomy.NECK_IN_HEAD) * factors["head"]


def _ankle_m(segment: str, factors: Mapping[str, anatomy.Place]) -> Float[np.ndarray, " 3"]:
    """Place of the ankle in the heel bone of the scaled model."""
    side = segment.partition("_")[0]
    mirror = [1.0, 1.0, 1.0 if side == "right" else -1.0]
    return np.array(anatomy.ANKLE_IN_FOOT) * mirror * factors[f"calcn_{side[0]}"]


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
    names = tuple(name for name, shown in zip(anatomy.MARKERS, is_shown, strict=True) if shown)
    frames = track.start_frame + np.flatnonzero(np.concatenate(of_pelvis))
    return MarkerPaths(names, frames, xyz_m[:, is_shown] - origin_m)


def _markers_m(
    motion: SkeletonMotion, track: Track3D, joints: JointSet, size: ModelSize
) -> tuple[Float[np.ndarray, "frames markers 3"], np.ndarray]:
    """World positions of all markers in some frames, and in which of them the pelvis is known."""
    positions_m, world_from_segment, known = forward_kinematics(motion), segments_from(motion), observed(track, joints)
    xyz_m = np.full((track.num_frames, len(anatomy.MARKERS), 3), np.nan)
    for number, marker in enumerate(anatomy.MARKERS.values()):
        match marker:
            case anatomy.CentreMarker(joint=joint, landmark=landmark) if landmark in joints.names:
                is_known = np.isfinite(track.xyz_m[:, joints.index(landmark)]).all(-1)
                xyz_m[is_known, number] = positions_m[is_known, INDEX[joint]]
            case anatomy.BoneMarker(segment=segment, joint=joint, offset_m=offset_m):
                offset = np.array(offset_m) * size.factors[marker.body]
                place_m = positions_m[:, INDEX[joint]] + world_from_segment[segment] @ offset
                xyz_m[known[segment], number] = place_m[known[segment]]
            case anatomy.SeenMarker(landmark=landmark, segment=segment) if landmark in joints.names:
                # Fingers that no camera saw rest in a pose of the model.
                is_known = known[segment] if segment.endswith("_hand") else np.ones(track.num_frames, bool)
                xyz_m[is_known, number] = track.xyz_m[is_known, joints.index(landmark)]
    return xyz_m, known["pelvis"]


GENERIC_MODEL, SCALED_MODEL = "generic.osim", "scaled.osim"
MARKER_SET, MARKER_PATHS = "markers.xml", "markers.trc"
SCALE_SETUP, IK_SETUP, MOTION = "scale.xml", "ik.xml", "ik.mot"

_MM_PER_M = 1000.0
_DECIMALS = 6
# Significant digits of the inverse kinematics, OpenSim's default.
_ACCURACY = "1e-05"


def encode_paths(paths: MarkerPaths, timebase: Timebase) -> Iterator[bytes]:
    """Write the paths of markers as TRC, piece by piece; metres, Y up, ``nan`` where a marker is unknown."""
    yield head(MARKER_PATHS, paths.names, timebase.frame_rate_hz, len(paths.frames))
    for rows in frame_blocks(len(paths.frames)):
        cells = fixed((paths.xyz_m[rows] @ Y_UP_FROM_WORLD.T).reshape(-1, 3 * len(paths.names)), 5, "\t")
        lines = (
            f"{frame + 1}\t{timebase.time_s(frame):.6f}\t{row}\n"
            for frame, row in zip(paths.frames[rows].tolist(), cells, strict=True)
        )
        yield "".join(lines).encode("ascii")


def encode_marker_set(names: Sequence[str], size: ModelSize) -> bytes:
    """Write the markers of the model, at their places in its bodies before these are scaled."""
    markers = "".join(
        f'<Marker name="{escape(name)}">'
        f"<socket_parent_frame>/bodyset/{anatomy.MARKERS[name].body}</socket_parent_frame>"
        f"<location>{_numbers(size.places_m[name])}</location><fixed>true</fixed></Marker>\n"
        for name in names
    )
    return _document(f'<MarkerSet name="markers"><objects>\n{markers}</objects></MarkerSet>')


def encode_scale_setup(name: str, size: ModelSize) -> bytes:
    """Write the setup of the scale tool: factors of the bodies, and the mass."""
    scales = "".join(
        f"<Scale><scales>{_numbers(factors)}</scales><segment>{body}</segment><apply>true</apply></Scale>\n"
        for body, factors in size.factors.items()
    )
    return _document(
        f'<ScaleTool name="{name}">\n'
        f"<mass>{size.mass_kg:.3f}</mass><height>{size.stature_m * _MM_PER_M:.1f}</height>\n"
        f"<GenericModelMaker><model_file>{GENERIC_MODEL}</model_file>"
        f"<marker_set_file>{MARKER_SET}</marker_set_file></GenericModelMaker>\n"
        "<ModelScaler><apply>true</apply><scaling_order>manualScale</scaling_order>\n"
        f"<ScaleSet><objects>\n{scales}</objects></ScaleSet>\n"
        "<preserve_mass_distribution>true</preserve_mass_distribution>"
        f"<output_model_file>{SCALED_MODEL}</output_model_file></ModelScaler>\n"
        "<MarkerPlacer><apply>false</apply></MarkerPlacer>\n"
        "</ScaleTool>"
    )


def encode_ik_setup(name: str, paths: MarkerPaths, timebase: Timebase) -> bytes:
    """Write the setup of the inverse kinematics: which markers count how much."""
    tasks = "".join(
        f'<IKMarkerTask name="{escape(marker)}"><apply>true</apply>'
        f"<weight>{anatomy.MARKERS[marker].weight:g}</weight></IKMarkerTask>\n"
        for marker in paths.names
    )
    first_s, last_s = (timebase.time_s(int(paths.frames[row])) for row in (0, -1))
    return _document(
        f'<InverseKinematicsTool name="{name}">\n'
        f"<results_directory>./</results_directory><model_file>{SCALED_MODEL}</model_file>\n"
        f"<constraint_weight>Inf</constraint_weight><accuracy>{_ACCURACY}</accuracy>\n"
        f"<time_range>{first_s:.6f} {last_s:.6f}</time_range>\n"
        f"<output_motion_file>{MOTION}</output_motion_file><report_errors>true</report_errors>\n"
        f"<marker_file>{MARKER_PATHS}</marker_file><coordinate_file></coordinate_file>\n"
        "<report_marker_locations>false</report_marker_locations>\n"
        f"<IKTaskSet><objects>\n{tasks}</objects></IKTaskSet>\n"
        "</InverseKinematicsTool>"
    )


def marker_errors_file(name: str) -> str:
    """Name of the file with the errors of markers that the inverse kinematics of a name writes."""
    return f"{name}_ik_marker_errors.sto"


def read_columns(content: str) -> Mapping[str, np.ndarray]:
    """Columns of a table that OpenSim has written, by name; empty if it is not whole."""
    names, *rows = content.partition("endheader")[2].strip().splitlines() or [""]
    cells = [row.split() for row in rows]
    width = len(names.split())
    if not cells or any(len(row) != width for row in cells):
        return {}
    return dict(zip(names.split(), np.array(cells, float).T, strict=True))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.{_DECIMALS}f}" for value in values)


def _document(content: str) -> bytes:
    return (
        f'<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40500">\n{content}\n</OpenSimDocument>\n'
    ).encode()
