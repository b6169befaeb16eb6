"""Compiled comparison of the rays of two sides in all pairs of views."""

from typing import no_type_check

from pipeline.core.runtime.jit import kernel

# Rays at an angle below 3 degrees pass near each other whatever they show.
_LEAST_SINE2 = 0.003


@kernel
@no_type_check
def _far(one, here, other, there, scale_m):
    """Distance from 0 to 1 between two rays, ``one[:6, here]`` and ``other[:6, there]``.

    The distance of two lines is the reciprocal product of their Plücker coordinates over the sine of their angle.
    """
    cosine = one[0, here] * other[0, there] + one[1, here] * other[1, there] + one[2, here] * other[2, there]
    apart_m = one[0, here] * other[3, there] + one[1, here] * other[4, there] + one[2, here] * other[5, there]
    apart_m += one[3, here] * other[0, there] + one[4, here] * other[1, there] + one[5, here] * other[2, there]
    sine2 = 1.0 - cosine * cosine
    apart_m2 = apart_m * apart_m / max(sine2, _LEAST_SINE2) if sine2 > _LEAST_SINE2 else 0.0
    return apart_m2 / (apart_m2 + scale_m * scale_m)


@kernel
@no_type_check
def add_gains(left, right, scale_m, gain):
    """Add the loss of agreement if one view of each pair is exchanged, by a joint of both sides.

    - ``left``, ``right``: direction, moment and score of each ray, (frames, 7, cameras), 0 where nothing is seen.
    - ``scale_m``: distance from a ray at which a view counts by half.
    - ``gain``: output, (frames, cameras, cameras).
    """
    for frame in range(len(gain)):
        lefts, rights, gains = left[frame], right[frame], gain[frame]
        for first in range(gain.shape[1] - 1):
            for later in range(first + 1, gain.shape[1]):
                left_left = _far(lefts, first, lefts, later, scale_m)
                left_right = _far(lefts, first, rights, later, scale_m)
                right_left = _far(rights, first, lefts, later, scale_m)
                right_right = _far(rights, first, rights, later, scale_m)
                w_left_left, w_left_right = lefts[6, first] * lefts[6, later], lefts[6, first] * rights[6, later]
                w_right_left, w_right_right = rights[6, first] * lefts[6, later], rights[6, first] * rights[6, later]
                loss = min(w_left_left, w_left_right) * (left_right - left_left)
                loss += min(w_right_right, w_right_left) * (right_left - right_right)
                loss += min(w_left_left, w_right_left) * (right_left - left_left)
                loss += min(w_right_right, w_left_right) * (left_right - right_right)
                gains[first, later] += loss / 2
                gains[later, first] += loss / 2
