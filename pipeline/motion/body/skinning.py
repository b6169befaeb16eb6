"""Skins that follow joints by linear blending."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.motion.body.joints import TWIST_JOINTS, twist_quat
from pipeline.motion.skeleton.model import INDEX, parents_of


def blend(
    vertices: Float[np.ndarray, "vertices 3"],
    carriers: Int[np.ndarray, "vertices influences"],
    weights: Float[np.ndarray, "vertices influences"],
    moved_from_rest: Float[np.ndarray, "joints 3 4"],
) -> Float[np.ndarray, "vertices 3"]:
    """Move vertices by the weighted mean of the affine maps of the joints that carry them."""
    maps = np.einsum("vi,vixy->vxy", weights, moved_from_rest[carriers])
    return (maps[..., :3] @ vertices[..., None])[..., 0] + maps[..., 3]


def about(
    matrices: Float[np.ndarray, "joints 3 3"],
    rest: Float[np.ndarray, "joints 3"],
    places: Float[np.ndarray, "joints 3"],
) -> Float[np.ndarray, "joints 3 4"]:
    """Affine maps that apply matrices about the joints at rest, and bring the joints to places."""
    return np.concatenate([matrices, (places - (matrices @ rest[..., None])[..., 0])[..., None]], axis=-1)


def placed(
    turns: Float[np.ndarray, "joints 3 3"], rest_m: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "joints 3"]:
    """Positions of a skeleton's joints and then of its twist joints, by their orientations; the root stays in place."""
    num_joints = len(turns) - len(TWIST_JOINTS)
    parents = [*parents_of(num_joints), *(INDEX[twist.parent] for twist in TWIST_JOINTS)]
    places_m = rest_m.copy()
    for joint, parent in enumerate(parents[1:], 1):
        places_m[joint] = places_m[parent] + turns[parent] @ (rest_m[joint] - rest_m[parent])
    return places_m


def world_from_joints(
    parent_from_joint: Float[np.ndarray, "joints 4"],
) -> Float[np.ndarray, "all_joints 3 3"]:
    """Orientations of a skeleton's joints and then of its twist joints, from the rotations of one frame."""
    num_joints = len(parent_from_joint)
    own = Rotation.from_quat(parent_from_joint).as_matrix()
    world = np.empty((num_joints + len(TWIST_JOINTS), 3, 3))
    for joint, parent in enumerate(parents_of(num_joints)):
        world[joint] = world[parent] @ own[joint] if joint else own[joint]
    for number, twist in enumerate(TWIST_JOINTS, num_joints):
        turn = Rotation.from_quat(twist_quat(parent_from_joint[None], twist)[0])
        world[number] = world[INDEX[twist.parent]] @ turn.as_matrix()
    return world
