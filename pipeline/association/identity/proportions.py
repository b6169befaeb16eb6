"""Body proportions as evidence of identity.

A body is described by the lengths of seven limbs. The lengths of a person over time are independent measurements, a
second each, of the person's own lengths, which come from a normal distribution over people. So the likelihood that some
measurements are of one person is known in closed form, without a threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet

# Limbs by the joints at their ends; both sides are measurements of one length.
_LIMBS = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "hip"),
)  # fmt: skip
_WIDTHS = "shoulder", "hip"
NUM_LIMBS = len(_LIMBS) + len(_WIDTHS)
_SIDES = "left", "right"
# Spread over people, as shares of a length: of stature, which all lengths share, and of each limb by itself.
_STATURE_SHARE, _LIMB_SHARE = 0.07, 0.04
# Standard deviations of a measurement of a second, if a session is too short to tell, and of what time does not average
# out: errors of the detector that depend on the pose.
_USUAL_M, _SYSTEMATIC_M, _SYSTEMATIC_SHARE = 0.03, 0.003, 0.2
# Shortest time in which a limb is measured, and length of the stretches that are compared with each other.
_SHORTEST_S, _STRETCH_S = 0.2, 1.0
# Time below which a median does not withstand outliers, which last.
_UNSURE_S = 0.5
# Log-likelihood ratio from which on a body may have become another one. A cut that was not needed is joined again.
_CHANGE = 8.0


def limb_lengths_m(track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames limbs 2"]:
    """Lengths of a track's limbs in each frame, left and right, NaN where an end was not measured.

    Widths of shoulders and hips have no side; they stand in both places.
    """

    def measured_m(name: str) -> Float[np.ndarray, "frames 3"]:
        joint = joints.index(name)
        return np.where((track.source[:, joint] == Source.MEASURED)[:, None], track.xyz_m[:, joint], np.nan)

    def length_m(start: str, end: str) -> Float[np.ndarray, " frames"]:
        if start not in joints.names or end not in joints.names:
            return np.full(track.num_frames, np.nan)
        return np.asarray(np.linalg.norm(measured_m(start) - measured_m(end), axis=-1))

    of_sides_m = [[length_m(f"{side}_{start}", f"{side}_{end}") for side in _SIDES] for start, end in _LIMBS]
    widths_m = [[length_m(*(f"{side}_{name}" for side in _SIDES))] * len(_SIDES) for name in _WIDTHS]
    return np.moveaxis(np.array([*of_sides_m, *widths_m]), -1, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Lengths measured in some frames of a track."""

    median_m: Float[np.ndarray, " limbs"]  # Median length of each limb, NaN where it was measured too shortly
    duration_s: Float[np.ndarray, " limbs"]  # Time for which each limb was measured, mean of both sides


def measure(lengths_m: Float[np.ndarray, "frames limbs 2"], frame_rate_hz: float) -> Measured:
    """Measure limbs in consecutive frames."""
    in_order = np.sort(lengths_m.transpose(1, 0, 2).reshape(lengths_m.shape[1], -1), axis=-1)
    count = np.isfinite(in_order).sum(-1)
    duration_s = count / (len(_SIDES) * frame_rate_hz)
    limbs = np.arange(len(in_order))
    # NaN is sorted to the end: the median is in the middle of the finite values.
    below, above = (in_order[limbs, np.maximum(place, 0)] for place in ((count - 1) // 2, count // 2 - (count == 0)))
    median_m = np.where(duration_s >= _SHORTEST_S, (below + above) / 2, np.nan)
    return Measured(median_m, np.where(np.isfinite(median_m), duration_s, 0.0))


class LimbProportions:
    """Likelihood that measurements are of one person.

    - ``measured``: measurements of all tracklets of a session.
    - ``spread_m``: standard deviation of a limb's length measured for a second; see ``spread_of_a_second_m``.
    - ``information``: inverse variances of each tracklet's lengths, 0 where a limb was not measured, (tracklets,
      limbs).
    - ``pull``: differences to the mean person, times the information, (tracklets, limbs).
    """

    def __init__(self, measured: Sequence[Measured], spread_m: Float[np.ndarray, " limbs"]) -> None:
        median_m = np.array([measurement.median_m for measurement in measured]).reshape(-1, NUM_LIMBS)
        duration_s = np.array([measurement.duration_s for measurement in measured]).reshape(-1, NUM_LIMBS)
        known = np.isfinite(median_m)
        mean_m = np.array([_weighted_median(*column) for column in zip(median_m.T, duration_s.T, strict=True)])
        with np.errstate(divide="ignore"):
            seconds = duration_s / (1 + (_UNSURE_S / duration_s) ** 2)
            variance = spread_m**2 * (1 / seconds + _SYSTEMATIC_SHARE**2) + _SYSTEMATIC_M**2
        self.information = np.where(known, 1 / variance, 0.0)
        self.pull = np.where(known, (median_m - mean_m) * self.information, 0.0)
        # Covariance over people: diagonal plus the common stature; its inverse by the formula of Sherman and Morrison.
        mean_m = np.where(np.isfinite(mean_m), mean_m, 1.0)
        self._own = 1 / (_LIMB_SHARE * mean_m) ** 2
        self._common = self._own * _STATURE_SHARE * mean_m
        self._share = 1 / (1 + (self._common * _STATURE_SHARE * mean_m).sum())
        self._log_prior = np.log(self._own).sum() + np.log(self._share)

    def log_likelihood(
        self, information: Float[np.ndarray, "*batch limbs"], pull: Float[np.ndarray, "*batch limbs"]
    ) -> Float[np.ndarray, "*batch"]:
        """Log-likelihood that measurements are of one person, up to terms that do not depend on who is who.

        ``information`` and ``pull`` are sums over the tracklets of the person.
        """
        own = information + self._own
        across = self._common / own
        left = 1 - self._share * (self._common * across).sum(-1)
        explained = (pull**2 / own).sum(-1) + self._share * (pull * across).sum(-1) ** 2 / left
        return np.asarray(0.5 * (explained + self._log_prior - np.log(own).sum(-1) - np.log(left)))


def changes(
    lengths_m: Float[np.ndarray, "frames limbs 2"], spread_m: Float[np.ndarray, " limbs"], frame_rate_hz: float
) -> list[int]:
    """Rows of a track at which the body may have become another one, by bisection at the most likely changes."""
    stretch = max(1, round(_STRETCH_S / 2 * frame_rate_hz))
    starts = np.arange(0, len(lengths_m), stretch)
    measured = [measure(lengths_m[start : start + stretch], frame_rate_hz) for start in starts.tolist()]
    proportions = LimbProportions(measured, spread_m)
    information, pull = (
        np.concatenate([np.zeros((1, NUM_LIMBS)), np.cumsum(values, axis=0)])
        for values in (proportions.information, proportions.pull)
    )

    def between(start: Int[np.ndarray, " _"] | int, stop: Int[np.ndarray, " _"] | int) -> np.ndarray:
        return proportions.log_likelihood(information[stop] - information[start], pull[stop] - pull[start])

    rows, spans = [], [(0, len(starts))]
    while spans:
        first, last = spans.pop()
        borders = np.arange(first + 1, last)
        gain = between(first, borders) + between(borders, last) - between(first, last)
        if not (gain > _CHANGE).any():
            continue
        border = int(borders[np.argmax(gain)])
        spans += [(first, border), (border, last)]
        around = slice(int(starts[border - 1]), int(starts[border]) + stretch)
        before_m, after_m = measured[border - 1].median_m, measured[border].median_m
        rows.append(around.start + _change_row(lengths_m[around], before_m, after_m))
    return sorted(rows)


def _change_row(
    lengths_m: Float[np.ndarray, "frames limbs 2"],
    before_m: Float[np.ndarray, " limbs"],
    after_m: Float[np.ndarray, " limbs"],
) -> int:
    errors_m = (np.abs(lengths_m - median_m[:, None]) for median_m in (before_m, after_m))
    nearer_before, nearer_after = (np.nansum(error_m, axis=(1, 2)) for error_m in errors_m)
    return int(np.argmin(np.append(0.0, np.cumsum(nearer_before - nearer_after))))


def spread_of_a_second_m(
    lengths_m: Sequence[Float[np.ndarray, "_ limbs 2"]], frame_rate_hz: float
) -> Float[np.ndarray, " limbs"]:
    """Standard deviation of a limb's length measured for a second, from the seconds of each track."""
    stretch = max(1, round(_STRETCH_S * frame_rate_hz))
    total, count = np.full(NUM_LIMBS, _USUAL_M**2), np.ones(NUM_LIMBS)
    for of_track_m in lengths_m:
        starts = range(0, len(of_track_m) - stretch + 1, stretch)
        measured = [measure(of_track_m[start : start + stretch], frame_rate_hz) for start in starts]
        for before, after in zip(measured[::2], measured[1::2], strict=False):
            difference_m = before.median_m - after.median_m
            # The difference of two measurements has twice the variance; of less than a second, more.
            weight = np.minimum(before.duration_s, after.duration_s)
            known = np.isfinite(difference_m)
            total += np.where(known, difference_m**2 / 2 * weight, 0.0)
            count += known
    return np.asarray(np.sqrt(total / count))


def _weighted_median(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    """Weighted median of the values that are not NaN; NaN if there are none."""
    known = np.isfinite(values)
    if not known.any():
        return np.nan
    order = np.argsort(values[known], kind="stable")
    up_to = np.cumsum(weights[known][order])
    return float(values[known][order][np.searchsorted(up_to, up_to[-1] / 2)])
