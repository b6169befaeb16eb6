"""Body at rest of GLB, FBX and USD files: its joints, and a mesh that follows them.

The mesh is a human, shaped by the person's bones, whose forearms have twist joints beside the skeleton's own; or an
ellipsoid around each bone, attached to the bone's joint.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.options.config import Body
from pipeline.export.presets import Convention
from pipeline.motion.body.installed import load
from pipeline.motion.body.joints import BODY_JOINTS, TWIST_JOINTS, TwistJoint, about, blend, placed
from pipeline.motion.body.shape import ShapedBody, shape_body, standing_ankle_m
from pipeline.motion.skeleton.model import INDEX, find_skeleton, parent_indices

_UP = np.array([0.0, 0.0, 1.0])
# Joint to which the skin of each joint shrinks: the end of the bone for the chest and the shoulders, so that triangles
# between them become lines.
_GATHERED = np.arange(len(BODY_JOINTS))
_GATHERED[INDEX["Chest"]] = INDEX["Neck"]
_GATHERED[[INDEX["LeftShoulder"], INDEX["RightShoulder"]]] = INDEX["LeftArm"], INDEX["RightArm"]

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
    # Indices of the joints that move each vertex, first the one that moves it most, and their weights, of sum 1
    joints: Int[np.ndarray, "vertices 4"]
    weights: Float[np.ndarray, "vertices 4"]
    triangles: Int[np.ndarray, "triangles 3"]  # Indices of ``vertices``, counterclockwise from outside


@dataclass(frozen=True, slots=True, eq=False)
class BodyAtRest:
    """Body in the rest pose of a file, standing on the floor at the origin, in the file's axes and unit."""

    # Of each joint of the skeleton from its parent, of the root from the origin
    offsets: Float[np.ndarray, "joints 3"]
    twists: tuple[TwistJoint, ...]  # Joints of the mesh after the skeleton's joints
    twist_offsets: Float[np.ndarray, "twists 3"]  # Of each twist joint from its parent
    positions: Float[np.ndarray, "all_joints 3"]  # Positions of the skeleton's joints, then of the twist joints
    mesh: BodyMesh

    @property
    def shrunk(self) -> Float[np.ndarray, "vertices 3"]:
        """Positions of the mesh's vertices between which triangles have hardly any area, in any pose.

        Each vertex is at the joint, of those that carry it, that the others move least. A joint stays where it is
        under the joint itself and its parent.
        """
        carriers, weights = self.mesh.joints, self.mesh.weights
        parents = np.array([*parent_indices(len(self.offsets)), *(INDEX[twist.parent] for twist in self.twists)])
        costs = np.empty(carriers.shape)
        for place, candidates in enumerate(carriers.T):
            is_still = (carriers == candidates[:, None]) | (carriers == parents[candidates][:, None])
            apart = np.linalg.norm(self.positions[carriers] - self.positions[candidates][:, None], axis=-1)
            moved = (weights * apart * ~is_still).sum(1)
            costs[:, place] = np.where(weights[:, place] > 0.0, moved, np.inf)
        centers = np.take_along_axis(carriers, costs.argmin(1)[:, None], 1)[:, 0]
        return self.positions[centers if not self.twists else _GATHERED[centers]]


@dataclass(frozen=True, slots=True)
class BodyChoice:
    """Body of a person in a file."""

    shape: Body = "capsules"
    floor: Floor | None = None  # Floor on which the soles of a human stand; ``None``: the floor of the skeleton at rest


CAPSULES = BodyChoice()
"""Ellipsoids around the bones."""


def body_at_rest(motion: SkeletonMotion, convention: Convention, choice: BodyChoice) -> BodyAtRest:
    """Body of a person in the rest pose of a convention.

    Raises ``ModelError`` if the body is a human, and that is not installed or was changed.
    """
    offsets = convention.rest_offsets(motion.bone_length_m)
    positions = np.zeros_like(offsets)
    for index, parent in enumerate(parent_indices(len(offsets))[1:], 1):
        positions[index] = positions[parent] + offsets[index]
    up = convention.file_from_world @ _UP
    positions -= (positions @ up).min() * up
    if choice.shape == "capsules":
        offsets[0] = positions[0]
        return BodyAtRest(offsets, (), np.empty((0, 3)), positions, capsules(offsets, positions))
    shaped = shape_body(load(), motion.bone_length_m, standing_ankle_m(motion, choice.floor))
    offsets[0] = convention.file_from_xyz_m(shaped.joints_m[0])
    positions += offsets[0] - positions[0]
    parents = [INDEX[twist.parent] for twist in TWIST_JOINTS]
    twist_offsets = np.array([twist.share * offsets[INDEX[twist.hand]] for twist in TWIST_JOINTS])
    mesh = _human(shaped, convention)
    return BodyAtRest(
        offsets, TWIST_JOINTS, twist_offsets, np.concatenate([positions, positions[parents] + twist_offsets]), mesh
    )


def _human(shaped: ShapedBody, convention: Convention) -> BodyMesh:
    """Mesh of a human in the rest pose of a convention."""
    lowered = convention.lowered(len(shaped.joints_m) - len(TWIST_JOINTS)).as_matrix()
    turns = np.concatenate([lowered, lowered[[INDEX[twist.parent] for twist in TWIST_JOINTS]]])
    moves = about(turns, shaped.joints_m, placed(turns, shaped.joints_m))
    vertices_m = blend(shaped.vertices_m, shaped.carriers, shaped.weights, moves)
    return BodyMesh(
        convention.file_from_xyz_m(vertices_m),
        _normals(vertices_m, shaped.triangles) @ convention.file_from_world.T,
        shaped.carriers,
        shaped.weights,
        shaped.triangles,
    )


def _normals(
    vertices: Float[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> Float[np.ndarray, "vertices 3"]:
    """Unit normals of vertices: the mean of their triangles' normals, by area."""
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], facing)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    # A body without size has no outside.
    return np.where(lengths > 0.0, normals / np.where(lengths > 0.0, lengths, 1.0), _UP)


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


def capsules(offsets: Float[np.ndarray, "joints 3"], rest: Float[np.ndarray, "joints 3"]) -> BodyMesh:
    """Build the mesh with an ellipsoid around each bone.

    Offsets from their parents, and positions, have all joints in the rest pose. A skeleton with fingers has
    palms and fingers in place of plain hands.
    """
    egg, egg_normals, triangles = _egg()
    skeleton = find_skeleton(len(offsets))
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
    joints = np.zeros((len(vertices) * len(egg), 4), np.int64)
    joints[:, 0] = np.concatenate(carriers)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
    return BodyMesh(
        np.concatenate(vertices), np.concatenate(normals), joints, weights, (first + triangles).reshape(-1, 3)
    )
