"""Heading and pitch of feet."""

import numpy as np
from jaxtyping import Float


def pitch_deg(along: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle of a direction from the back to the front of a foot below the horizontal; heel up is positive."""
    return np.degrees(np.arctan2(-along[..., 2], np.linalg.norm(along[..., :2], axis=-1)))


def heading_error_deg(
    predicted: Float[np.ndarray, "*batch 3"], truth: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Angle on the floor from a true direction to the predicted direction, positive to the left."""
    cross = truth[..., 0] * predicted[..., 1] - truth[..., 1] * predicted[..., 0]
    return np.degrees(np.arctan2(cross, (truth[..., :2] * predicted[..., :2]).sum(-1)))
