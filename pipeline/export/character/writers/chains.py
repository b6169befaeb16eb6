"""Places of a tree of bones of which few turn: readers compute them block by block from what a file states."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.rotations import times


def chained_places(
    parents: Sequence[int],
    offsets: Float[np.ndarray, "bones 3"],
    turns: Sequence[Float[np.ndarray, "3 3"] | None],
    moving_offsets: Mapping[int, Float[np.ndarray, "frames 3"]],
    moving_turns: Mapping[int, Float[np.ndarray, "frames 3 3"]],
) -> list[Float[np.ndarray, "_ 3"]]:
    """Places of bones in the axes above the tree; a bone that nothing moves has one place for all frames.

    Parameters
    ----------
    parents
        Place of each bone's parent in the list, before the bone; -1 at the top.
    offsets, turns
        Place of each bone in its parent, and its rotation and scale, ``None`` for the identity.
    moving_offsets, moving_turns
        Those of bones that move, by place in the list.
    """
    places: list[Float[np.ndarray, "_ 3"]] = []
    worlds: list[Float[np.ndarray, "_ 3 3"]] = []
    for bone, parent in enumerate(parents):
        place, world = (places[parent], worlds[parent]) if parent >= 0 else (np.zeros((1, 3)), np.eye(3)[None])
        if bone in moving_offsets:
            places.append(place + (world @ moving_offsets[bone][..., None])[..., 0])
        else:
            places.append(place + times(world, offsets[bone]))
        turn = turns[bone]
        if bone in moving_turns:
            world = world @ moving_turns[bone]
        elif turn is not None:
            world = times(world, turn)
        worlds.append(world)
    return places


def together(places: Sequence[Float[np.ndarray, "_ 3"]], num_frames: int) -> Float[np.ndarray, "frames bones 3"]:
    """Places of bones in one array."""
    joined = np.empty((num_frames, len(places), 3))
    for bone, place in enumerate(places):
        joined[:, bone] = place
    return joined
