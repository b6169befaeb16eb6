"""Part affinity fields: how they are kept, and what they say of two points.

After Cao et al., "Realtime multi-person 2D pose estimation using part affinity fields" (CVPR 2017), section 2.3.
"""

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.geometry.field_kernels import integrate

# A sample of a field agrees with a segment if its dot product is above this (OpenPose's own threshold).
_AGREEING = 0.05


def quantise(pafs: Float[np.ndarray, "*batch"]) -> UInt8[np.ndarray, "*batch"]:
    """Fields as bytes: 128 for 0, a step of 1 / 127, from -1 to 1."""
    return (np.clip(pafs, -1.0, 1.0) * 127.0 + 128.5).astype(np.uint8)


def connectivity(
    fields: UInt8[np.ndarray, "limbs 2 height width"],
    limb: Int[np.ndarray, " n"],
    begin: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Connectivity score s of two points of an image (their eq. 10), and the share of the segment that agrees.

    Parameters
    ----------
    fields
        Bytes, as of ``quantise``.
    limb
        Which field.
    begin, end
        Where the limb would begin and end, x and y in cells.

    Returns
    -------
        Both NaN where an end is not on the map, or NaN.
    """
    # Whether an array may be written to is part of its type, and one type is compiled.
    fields = fields.view()
    fields.flags.writeable = False
    mean, share = np.empty(len(limb)), np.empty(len(limb))
    integrate(fields, limb, begin, end, _AGREEING, mean, share)
    return mean, share
