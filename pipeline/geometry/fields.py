"""Part affinity fields: storage as bytes, and connectivity of two points.

Source: Cao et al., "Realtime multi-person 2D pose estimation using part affinity fields" (CVPR 2017), section 2.3.
"""

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.geometry.field_kernels import integrate

# A sample of a field agrees with a segment if their dot product is above this threshold of OpenPose.
_AGREEING = 0.05


def quantise(pafs: Float[np.ndarray, "*batch"]) -> UInt8[np.ndarray, "*batch"]:
    """Quantise fields to bytes: 128 for 0, steps of 1 / 127, from -1 to 1."""
    return (np.clip(pafs, -1.0, 1.0) * 127.0 + 128.5).astype(np.uint8)


def connectivity(
    fields: UInt8[np.ndarray, "limbs 2 height width"],
    limb: Int[np.ndarray, " n"],
    begin: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Connectivity score s of two image points (eq. 10), and the share of samples that agree with the segment.

    Fields are bytes of ``quantise``, and ``limb`` is the index of the field of each pair; its assumed start and end are
    x and y in cells. Both results are NaN where an end is NaN or outside of the map.
    """
    # Writeability is part of an array's type for numba; the kernel is compiled for read-only arrays.
    fields = fields.view()
    fields.flags.writeable = False
    mean, share = np.empty(len(limb)), np.empty(len(limb))
    integrate(fields, limb, begin, end, _AGREEING, mean, share)
    return mean, share
