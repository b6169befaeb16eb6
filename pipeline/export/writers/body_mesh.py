"""Body at rest of GLB and FBX files: its joints, and an ellipsoid around each bone, attached to the bone's joint."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from pipeline.export.presets import Convention
from pipeline.skeleton.model import INDEX, parents_of, skeleton_of

_UP = np.array([0.0, 0.0, 1.0])

# Half widths (to the side, to the front) of the ellipsoid around a bone, as shares of the bone's length, by the kind of
# the bone's end.
_HALF_WIDTHS = {
    "Spine": (1.35, 1.0),
    "Chest": (0.65, 0.45),
    "Neck": (0.85, 0.6),
    "Head": (0.28, 0.28),
    "HeadEnd": (0.75, 0.9),
    "Arm": (0.35, 0.35),
    "ForeArm": (0.16, 0.16),
    "Hand": (0.15, 0.15),
    "HandEnd": (0.22, 0.12),
    "UpLeg": (0.9, 0.9),
    "Leg": (0.19, 0.19),
    "Foot": (0.14, 0.14),
    "FootEnd": (0.22, 0.18),
}
# The same for hands with fingers, in the rest pose downwards and to the front. The palm is the ellipsoid around the
# bone to the middle finger; the bones to the other fingers' bases lie within it.
_HAND_HALF_WIDTHS = {
    "HandMiddle1": (0.17, 0.5),
    "HandThumb2": (0.26, 0.26),
    "HandThumb3": (0.27, 0.27),
    "HandThumb3End": (0.3, 0.3),
    **{
        f"Hand{finger}{number}": (share, share)
        for finger in ("Index", "Middle", "Ring", "Pinky")
        for number, share in (("2", 0.18), ("3", 0.28), ("3End", 0.38))
    },
}
# Kinds of bones whose ellipsoid is centred on the joint.
_CENTRED = frozenset({"HeadEnd"})
# Half length of an ellipsoid, as a share of the bone's length: around the middle of the bone, or around its joint.
_HALF_LENGTH, _CENTRED_HALF_LENGTH = 0.55, 1.0
# Exponent of the profile (Lamé's curve), between 2 for an ellipse and infinity for a cylinder.
_FULLNESS = 2.6
_NUM_RINGS, _NUM_SPOKES = 9, 12


@dataclass(frozen=True, slots=True, eq=False)
class BodyMesh:
    """Triangle mesh of a skeleton in its rest pose."""

    # Positions and unit normals, in the unit and axes of the skeleton's offsets
    vertices: Float[np.ndarray, "vertices 3"]
    normals: Float[np.ndarray, "vertices 3"]
    joint: Int[np.ndarray, " vertices"]  # Index in the skeleton of the joint that moves each vertex
    triangles: Int[np.ndarray, "triangles 3"]  # Indices of ``vertices``, counterclockwise from outside


@dataclass(frozen=True, slots=True, eq=False)
class BodyAtRest:
    """Body in the rest pose of a file, standing on the floor at the origin, in the file's axes and unit."""

    offsets: Float[np.ndarray, "joints 3"]  # Of each joint from its parent, of the root from the origin
    positions: Float[np.ndarray, "joints 3"]
    mesh: BodyMesh


def body_at_rest(bone_length_m: Float[np.ndarray, " joints"], convention: Convention) -> BodyAtRest:
    """Body in the rest pose of a convention; ``bone_length_m`` are the lengths of its bones."""
    offsets = convention.rest_offsets(bone_length_m)
    positions = np.zeros_like(offsets)
    for index, parent in enumerate(parents_of(len(offsets))[1:], 1):
        positions[index] = positions[parent] + offsets[index]
    up = convention.file_from_world @ _UP
    positions -= (positions @ up).min() * up
    offsets[0] = positions[0]
    return BodyAtRest(offsets, positions, body_mesh(offsets, positions))


@cache
def _egg() -> tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "vertices 3"], Int[np.ndarray, "triangles 3"]]:
    """Vertices, normals and triangles of a rounded unit cylinder, in rings around its third axis."""
    polar = np.linspace(0.0, np.pi, _NUM_RINGS)
    around = np.linspace(0.0, 2.0 * np.pi, _NUM_SPOKES, endpoint=False)
    wide = np.abs(np.sin(polar)) ** (2.0 / _FULLNESS)
    high = np.sign(np.cos(polar)) * np.abs(np.cos(polar)) ** (2.0 / _FULLNESS)
    circle = np.column_stack([np.cos(around), np.sin(around), np.ones(_NUM_SPOKES)])
    points = circle * np.column_stack([wide, wide, high])[:, None]
    steep, flat = wide ** (_FULLNESS - 1.0), np.sign(high) * np.abs(high) ** (_FULLNESS - 1.0)
    normals = circle * np.column_stack([steep, steep, flat])[:, None]
    triangles = []
    for ring in range(_NUM_RINGS - 1):
        for spoke in range(_NUM_SPOKES):
            following = (spoke + 1) % _NUM_SPOKES
            a, b = ring * _NUM_SPOKES + spoke, ring * _NUM_SPOKES + following
            c, d = a + _NUM_SPOKES, b + _NUM_SPOKES
            # At the poles, one of the two triangles has no area and is left out.
            triangles += [(a, c, d)] * (ring < _NUM_RINGS - 2) + [(a, d, b)] * (ring > 0)
    return points.reshape(-1, 3), normals.reshape(-1, 3), np.array(triangles)


def body_mesh(offsets: Float[np.ndarray, "joints 3"], rest: Float[np.ndarray, "joints 3"]) -> BodyMesh:
    """Build the mesh with an ellipsoid around each bone.

    Offsets from their parents, and positions, are those of all joints in the rest pose. A skeleton with fingers has
    palms and fingers in place of plain hands.
    """
    egg, egg_normals, triangles = _egg()
    skeleton = skeleton_of(len(offsets))
    half_widths = _HALF_WIDTHS
    if any(joint.kind in _HAND_HALF_WIDTHS for joint in skeleton):
        half_widths = _HALF_WIDTHS | _HAND_HALF_WIDTHS
        del half_widths["HandEnd"]
    vertices, normals, carriers = [], [], []
    for index, joint in enumerate(skeleton):
        length = np.linalg.norm(offsets[index])
        if joint.parent is None or joint.kind not in half_widths or length == 0.0:
            continue
        parent = INDEX[joint.parent]
        along = offsets[index] / length
        side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [0.0, 1.0, 0.0])
        axes = np.column_stack([side / np.linalg.norm(side), np.cross(along, side / np.linalg.norm(side)), along])
        is_centred = joint.kind in _CENTRED
        half_length = _CENTRED_HALF_LENGTH if is_centred else _HALF_LENGTH
        radii = length * np.array([*half_widths[joint.kind], half_length])
        middle = rest[parent] + (0.0 if is_centred else 0.5) * offsets[index]
        vertices.append(middle + (egg * radii) @ axes.T)
        normal = (egg_normals / radii) @ axes.T
        normals.append(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
        carriers.append(np.full(len(egg), parent))
    first = np.arange(len(vertices))[:, None, None] * len(egg)
    return BodyMesh(
        np.concatenate(vertices), np.concatenate(normals), np.concatenate(carriers), (first + triangles).reshape(-1, 3)
    )
