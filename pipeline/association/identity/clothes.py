"""Colours of clothes as evidence that two pieces of tracks are of the same person, or of different people.

The distance of two mean histograms is Hellinger's, the square root of 1 minus Bhattacharyya's coefficient: 0 for equal
ones, 1 for histograms without a common bin. Cameras differ in white balance, so pieces are compared in the cameras
that saw both; only if there are none, across cameras.

How much a distance says depends on the clothes of the session. ``learn_contrast`` measures it: distances within pieces
against distances of pieces that are certainly of different people. The log-likelihood ratio is the ratio of two normal
distributions with the same spread, a straight line that falls with the distance. People in uniforms give a line that
is nearly flat at 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from pipeline.association.identity.tracklets import Tracklet
from pipeline.geometry.track_assembly import Person

MAX_LOG_RATIO = 4.0
"""Largest ratio either way, in nats: clothes support geometry, and don't outvote it."""

# Detections behind a mean histogram from which on it is compared.
_MIN_DETECTIONS = 5
# Pieces from which a session's distances are learnt: the time grows with the square of their number.
_MAX_PIECES = 100
# Tracklets that are compared, for the same reason.
_MAX_TRACKLETS = 1_000


class Clothes(NamedTuple):
    """Mean colours of a piece of a track."""

    share: np.ndarray  # Mean histogram in each camera, (cameras, parts, bins), with sum 1; zeros where it is unknown
    num_detections: np.ndarray  # Detections behind it, (cameras, parts)

    @property
    def is_known(self) -> Bool[np.ndarray, "cameras parts"]:
        """True if there are enough detections."""
        return np.asarray(self.num_detections >= _MIN_DETECTIONS)

    def joined(self, other: "Clothes") -> "Clothes":
        """Mean colours of both pieces together."""
        num_detections = self.num_detections + other.num_detections
        total = self.share * self.num_detections[..., None] + other.share * other.num_detections[..., None]
        return Clothes(total / np.maximum(num_detections, 1)[..., None], num_detections)


@dataclass(frozen=True, slots=True)
class ColourDistances:
    """Distances of two pieces of the same person, and of different people: normal distributions."""

    # Means
    same: float
    different: float
    spread: float  # Common standard deviation

    def log_ratio(self, distance: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Logarithm of the likelihoods' ratio, same person to different people, within ``MAX_LOG_RATIO``."""
        contrast = max(0.0, self.different - self.same)
        ratio = contrast * ((self.same + self.different) / 2 - distance) / self.spread**2
        return np.asarray(np.clip(ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO))


@dataclass(frozen=True, slots=True)
class Contrast:
    """Distances of people in a session, seen by the same camera and by two cameras."""

    within_camera: ColourDistances
    across_cameras: ColourDistances


# Distance of two pieces of the same person, on a sample and a rendered capture (docs/lab/tracking-notes.md). Pieces
# are short and show less than a person changes over a session, so a session's own distances can only raise it.
_SAME_WITHIN_CAMERA, _SAME_ACROSS_CAMERAS = 0.14, 0.36
# Least standard deviation. The captures have 0.05 to 0.13; other light, and another side of a body, have more.
_LEAST_SPREAD = 0.2


def mean_clothes(
    colour: UInt8[np.ndarray, "detections parts bins"], camera: Int[np.ndarray, " detections"], num_cameras: int
) -> Clothes:
    """Average the colours of a piece of a track, camera by camera.

    Colours and cameras are of the piece's rows in ``observations.Detections2D``.
    """
    of_cameras = [colour[camera == number] for number in range(num_cameras)]
    total = np.array([of_camera.sum(0, np.float64) for of_camera in of_cameras])
    num_detections = np.array([of_camera.any(-1).sum(0, np.int64) for of_camera in of_cameras])
    sums = total.sum(-1, keepdims=True)
    return Clothes(total / np.where(sums > 0, sums, 1.0), num_detections)


def measure_clothes(
    detection: Int[np.ndarray, "frames _"], colour: UInt8[np.ndarray, "detections parts bins"], num_cameras: int
) -> Clothes:
    """Average the colours of some frames of a person.

    ``detection`` has those frames of ``Observations.detection``, no rows if it was not recorded; ``colour`` is the
    colour of all detections, ``observations.Detections2D.colour``.
    """
    frames, cameras = np.nonzero(detection >= 0)
    return mean_clothes(colour[detection[frames, cameras]], cameras, num_cameras)


def log_likelihood_ratios(pieces: Sequence[Clothes], contrast: Contrast) -> Float[np.ndarray, "pieces pieces"]:
    """Logarithm of the likelihoods' ratio of all pairs of pieces' colours: same person to different people.

    Ratios are in nats, at most ``MAX_LOG_RATIO`` either way; 0 on the diagonal and if no part is known of both.
    """
    ratios = np.zeros((len(pieces), len(pieces)))
    roots, is_known = _stacked(pieces)
    for row in range(len(pieces) - 1):
        later = slice(row + 1, None)
        of_row = _ratios(roots[row], is_known[row], roots[later], is_known[later], contrast)
        ratios[row, later] = ratios[later, row] = of_row
    return ratios


def clothes_likelihood_ratios(
    piece: Clothes, others: Sequence[Clothes], contrast: Contrast
) -> Float[np.ndarray, " others"]:
    """Logarithm of the likelihoods' ratio of a piece's colours and of each other piece's.

    See ``log_likelihood_ratios``.
    """
    roots, is_known = _stacked([piece, *others])
    return _ratios(roots[0], is_known[0], roots[1:], is_known[1:], contrast)


def _ratios(
    root: Float[np.ndarray, "cameras parts bins"],
    is_known: Bool[np.ndarray, "cameras parts"],
    roots: Float[np.ndarray, "others cameras parts bins"],
    are_known: Bool[np.ndarray, "others cameras parts"],
    contrast: Contrast,
) -> Float[np.ndarray, " others"]:
    """Ratios of a piece and other ones, across cameras only where no camera saw both."""
    within = _within_cameras(root, is_known, roots, are_known)
    ratios = contrast.within_camera.log_ratio(within)
    apart = np.flatnonzero(np.isnan(within))
    across = _across_cameras(root, is_known, roots[apart], are_known[apart])
    ratios[apart] = contrast.across_cameras.log_ratio(across)
    return np.nan_to_num(ratios)


def learn_contrast(
    pieces: Sequence[Clothes],
    halves: Sequence[tuple[Clothes, Clothes]],
    are_different: Bool[np.ndarray, "pieces pieces"],
) -> Contrast:
    """Measure how much the clothes of a session tell.

    ``pieces``: colours of pieces of tracks over which identity is not in doubt. ``halves``: colours of the first and of
    the second half of each piece. ``are_different``: whether two pieces are certainly of different people: they exist
    at the same time. Returns contrast of the session; ratios are 0 where none of the pieces are of different people.
    """
    most_seen = sorted(range(len(pieces)), key=lambda k: (-int(pieces[k].num_detections.sum()), k))[:_MAX_PIECES]
    roots, is_known = _stacked([pieces[k] for k in most_seen])
    same_within, same_across, different_within, different_across = [], [], [], []
    for row, number in enumerate(most_seen):
        (first, second), (is_first, is_second) = _stacked(halves[number])
        same_within.append(_within_cameras(first, is_first, second[None], is_second[None]))
        same_across.append(_across_cameras(roots[row], is_known[row], roots[[row]], is_known[[row]]))
        others = [other for other in range(row + 1, len(most_seen)) if are_different[number, most_seen[other]]]
        one_and_others = roots[row], is_known[row], roots[others], is_known[others]
        different_within.append(_within_cameras(*one_and_others))
        different_across.append(_across_cameras(*one_and_others))
    return Contrast(
        _learn(same_within, different_within, _SAME_WITHIN_CAMERA),
        _learn(same_across, different_across, _SAME_ACROSS_CAMERAS),
    )


def tracklet_ratios(
    pieces: Sequence[Person],
    tracklets: Sequence[Tracklet],
    colour: UInt8[np.ndarray, "detections parts bins"],
    num_cameras: int,
) -> Float[np.ndarray, "tracklets tracklets"]:
    """Ratios of all pairs of tracklets, with the contrast of their session; 0 beside the longest tracklets.

    Tracklets were cut from ``pieces``; ``colour`` is explained by ``measure_clothes``.
    """
    ratios = np.zeros((len(tracklets), len(tracklets)))
    length = np.array([tracklet.stop_frame - tracklet.start_frame for tracklet in tracklets])
    longest = np.sort(np.argsort(-length, kind="stable")[:_MAX_TRACKLETS])
    chosen = [tracklets[number] for number in longest.tolist()]

    def clothes(tracklet: Tracklet, start_frame: int, stop_frame: int) -> Clothes:
        track, seen = pieces[tracklet.track]
        rows = slice(start_frame - track.start_frame, stop_frame - track.start_frame)
        return measure_clothes(seen.detection[rows], colour, num_cameras)

    whole = [clothes(tracklet, tracklet.start_frame, tracklet.stop_frame) for tracklet in chosen]
    middles = [(tracklet.start_frame + tracklet.stop_frame) // 2 for tracklet in chosen]
    halves = [
        (clothes(tracklet, tracklet.start_frame, middle), clothes(tracklet, middle, tracklet.stop_frame))
        for tracklet, middle in zip(chosen, middles, strict=True)
    ]
    start, stop = (np.array([getattr(tracklet, name) for tracklet in chosen]) for name in ("start_frame", "stop_frame"))
    meet = (start[:, None] < stop) & (start < stop[:, None]) & ~np.eye(len(chosen), dtype=np.bool_)
    ratios[np.ix_(longest, longest)] = log_likelihood_ratios(whole, learn_contrast(whole, halves, meet))
    return ratios


def _learn(
    same: Sequence[Float[np.ndarray, " _"]], different: Sequence[Float[np.ndarray, " _"]], least_same: float
) -> ColourDistances:
    """Distributions of distances; NaN is left out."""
    of_same, of_different = _finite(same), _finite(different)
    mean_same = max(least_same, float(of_same.mean())) if len(of_same) else least_same
    # One more pair as if it were of the same person: little evidence of a difference gives a small difference.
    mean_different = float((of_different.sum() + mean_same) / (len(of_different) + 1))
    variance = (_variance(of_same) + _variance(of_different)) / 2
    return ColourDistances(mean_same, mean_different, max(_LEAST_SPREAD, float(np.sqrt(variance))))


def _finite(parts: Sequence[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " n"]:
    values = np.concatenate([np.empty(0), *parts])
    return values[np.isfinite(values)]


def _variance(values: Float[np.ndarray, " n"]) -> float:
    return float(values.var()) if len(values) else 0.0


def _stacked(
    pieces: Sequence[Clothes],
) -> tuple[Float[np.ndarray, "pieces cameras parts bins"], Bool[np.ndarray, "pieces cameras parts"]]:
    """Square roots of the histograms, and whether they are known."""
    if not pieces:
        return np.empty((0, 0, 0, 0)), np.empty((0, 0, 0), np.bool_)
    return np.sqrt([piece.share for piece in pieces]), np.array([piece.is_known for piece in pieces])


def _within_cameras(
    root: Float[np.ndarray, "cameras parts bins"],
    is_known: Bool[np.ndarray, "cameras parts"],
    roots: Float[np.ndarray, "others cameras parts bins"],
    are_known: Bool[np.ndarray, "others cameras parts"],
) -> Float[np.ndarray, " others"]:
    """Mean distance of a piece from other ones in the cameras that saw both; NaN if there are none."""
    distance = _hellinger(np.einsum("cpb,ocpb->ocp", root, roots))
    return _mean(distance, is_known & are_known)


def _across_cameras(
    root: Float[np.ndarray, "cameras parts bins"],
    is_known: Bool[np.ndarray, "cameras parts"],
    roots: Float[np.ndarray, "others cameras parts bins"],
    are_known: Bool[np.ndarray, "others cameras parts"],
) -> Float[np.ndarray, " others"]:
    """Mean distance of a piece from other ones over the pairs of different cameras; NaN if there are none."""
    distance = _hellinger(np.einsum("cpb,odpb->ocdp", root, roots, optimize=True))
    is_pair = ~np.eye(len(root), dtype=np.bool_)[:, :, None]
    return _mean(distance, is_pair & is_known[:, None] & are_known[:, None])


def _hellinger(coefficient: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    return np.asarray(np.sqrt(np.maximum(0.0, 1.0 - coefficient)))


def _mean(distance: Float[np.ndarray, "others *compared"], mask: Bool[np.ndarray, "others *compared"]) -> np.ndarray:
    """Mean over all axes but the first where a mask is set; NaN where it is set nowhere."""
    axes = tuple(range(1, distance.ndim))
    count = mask.sum(axes)
    return np.asarray(np.where(mask, distance, 0.0).sum(axes) / np.where(count, count, np.nan))
