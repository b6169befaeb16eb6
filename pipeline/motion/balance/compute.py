"""Centre of mass of a person over time, its velocity, momentum, and the margin of stability.

The extrapolated centre of mass is ``x + v / sqrt(g / l)``, l being the distance of the centre from the ankles, and the
margin of stability its distance from the border of the base of support, negative outside (Hof et al. 2005, "The
condition for dynamic stability", J. Biomech. 38). The base is the convex hull of the feet on the floor: each is as long
as the way from heel to toe, and as wide as a usual foot of this length (Drillis and Contini 1966).

Deviations follow from the standard deviations of the joints, which count as independent: the centre is a sum of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import lstsq
from scipy.ndimage import convolve1d
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.angles.compute import segments_from
from pipeline.motion.balance.segment_masses import SegmentMasses, segment_masses

GRAVITY_M_S2 = 9.81
# Time of the parabola that is fitted for a velocity, and its least number of frames.
_WINDOW_S, _MIN_FRAMES = 0.12, 5
# Breadth of a foot over its length: 0.055 over 0.152 of stature.
_BREADTH = 0.36
# Distance of points that are one.
_SAME_M = 1e-9
# Frames that are worked on at once, so that a long take needs little memory.
_BLOCK_FRAMES = 2048


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Balance of a person in the frames of a motion; NaN where a joint is unknown."""

    start_frame: int  # Output frame of the first row
    mass_kg: float | None  # Mass of the person; ``None``: momenta are for each kilogram
    centre_m: Float[np.ndarray, "frames 3"]  # Centre of mass in the world
    sigma_m: Float[np.ndarray, " frames"]  # Standard deviation of a coordinate of the centre
    velocity_m_s: Float[np.ndarray, "frames 3"]
    extrapolated_m: Float[np.ndarray, "frames 2"]  # Extrapolated centre of mass on the floor
    # Angular momentum about the centre of mass, in kg m^2/s; per kilogram without a mass
    angular_momentum: Float[np.ndarray, "frames 3"]
    margin_m: Float[np.ndarray, " frames"]  # Margin of stability; NaN without a foot on the floor
    margin_sigma_m: Float[np.ndarray, " frames"]

    @property
    def momentum(self) -> Float[np.ndarray, "frames 3"]:
        """Momentum in kg m/s, for each kilogram without a mass."""
        return (self.mass_kg or 1.0) * self.velocity_m_s

    @property
    def frames(self) -> range:
        """Output frames of the rows."""
        return range(self.start_frame, self.start_frame + len(self.centre_m))


def balance_of(motion: SkeletonMotion, track: Track3D, joints: JointSet, subject: Subject) -> Balance | None:
    """Compute the balance of a person.

    ``motion``: motion of the skeleton, whose rotations turn the segments, with the contacts of the feet. ``track``:
    final positions of the joints in the same frames. ``subject``: table of segments, sex and mass. Returns balance in
    the frames of the track; ``None`` if the joints of the detector lack one of a limb.
    """
    masses = segment_masses(subject, joints, track.xyz_m)
    if masses is None:
        return None
    frame_rate_hz = motion.frame_rate_hz
    window = _window(len(track.xyz_m), frame_rate_hz)
    num_frames = len(track.xyz_m)
    centre_m, spin = np.empty((2, num_frames, 3))
    for start in range(0, num_frames, _BLOCK_FRAMES):
        # A block has the frames of the filter before and after it.
        first, last = max(start - window, 0), min(start + _BLOCK_FRAMES + window, num_frames)
        of_rows = replace(
            motion, root_m=motion.root_m[first:last], parent_from_joint=motion.parent_from_joint[first:last]
        )
        world_from_segment = segments_from(of_rows)
        turns = np.stack([world_from_segment[name] for name in masses.orientations], axis=1)
        centres_m, length_m = segment_centres(masses, track.xyz_m[first:last], turns)
        middle_m = np.einsum("s,fsk->fk", masses.mass, centres_m)
        arms_m = centres_m - middle_m[:, None]
        own = slice(start, min(start + _BLOCK_FRAMES, num_frames))
        kept = slice(own.start - first, own.stop - first)
        centre_m[own] = middle_m[kept]
        spin[own] = _angular_momentum(masses, arms_m, length_m, turns, window, frame_rate_hz)[kept]
    velocity_m_s = _velocity(centre_m, window, frame_rate_hz)
    variance_m2 = np.full(len(centre_m), np.nan)
    if track.uncertainty_m is not None:
        used = masses.weights != 0
        variance_m2 = (masses.weights[used] ** 2 * track.uncertainty_m[:, used] ** 2).sum(-1)
    ankles_m = track.xyz_m[:, joints.indices(tuple(f"{side}_ankle" for side in SIDES))].mean(1)
    pendulum_m = np.linalg.norm(centre_m - ankles_m, axis=-1)
    time_s = np.sqrt(np.nanmedian(pendulum_m) / GRAVITY_M_S2) if np.isfinite(pendulum_m).any() else np.nan
    extrapolated_m = (centre_m + velocity_m_s * time_s)[:, :2]
    # Sum of the squared coefficients of the velocity's filter, a fitted line.
    half = window // 2
    gain = frame_rate_hz**2 / (2.0 * (np.arange(1, half + 1) ** 2).sum()) if half else np.nan
    sigma_of_margin_m = np.sqrt(variance_m2 * (1.0 + gain * time_s**2))
    margin_m = _margins(track, joints, motion.contacts, extrapolated_m)
    return Balance(
        track.start_frame,
        subject.mass_kg,
        centre_m=read_only(centre_m),
        sigma_m=read_only(np.sqrt(variance_m2)),
        velocity_m_s=read_only(velocity_m_s),
        extrapolated_m=read_only(extrapolated_m),
        angular_momentum=read_only((subject.mass_kg or 1.0) * spin),
        margin_m=read_only(margin_m),
        margin_sigma_m=read_only(np.where(np.isfinite(margin_m), sigma_of_margin_m, np.nan)),
    )


def balance_document(balance: Balance | None) -> dict[str, float | None] | None:
    """Figures of a person's balance, rounded; ``None`` without a known frame."""
    if balance is None or not np.isfinite(balance.centre_m).any():
        return None
    figures = {
        "height_m": np.nanmean(balance.centre_m[:, 2]),
        "lowest_m": np.nanmin(balance.centre_m[:, 2]),
        "highest_m": np.nanmax(balance.centre_m[:, 2]),
        "sigma_m": _quantile(balance.sigma_m, 0.5),
        "speed_m_s": _quantile(np.linalg.norm(balance.velocity_m_s, axis=1), 0.5),
        "angular_momentum_max": _quantile(np.linalg.norm(balance.angular_momentum, axis=1), 1.0),
        "margin_m": _quantile(balance.margin_m, 0.5),
        "margin_min_m": _quantile(balance.margin_m, 0.0),
        "mass_kg": balance.mass_kg or np.nan,
    }
    return {name: round(float(value), 4) if np.isfinite(value) else None for name, value in figures.items()}


def _quantile(values: Float[np.ndarray, " frames"], share: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else np.nan


def segment_centres(
    masses: SegmentMasses, xyz_m: Float[np.ndarray, "frames joints 3"], turns: Float[np.ndarray, "frames segments 3 3"]
) -> tuple[Float[np.ndarray, "frames segments 3"], Float[np.ndarray, "frames segments"]]:
    """Centres of mass of segments in metres, and their lengths; NaN where one of their joints is unknown."""

    def weighted(weights: Float[np.ndarray, "segments joints"]) -> Float[np.ndarray, "frames segments 3"]:
        known = np.nan_to_num(xyz_m)
        # An unknown joint makes the segments unknown that it has a weight in, and no others.
        lacks = np.einsum("sj,fj->fs", (weights != 0).astype(float), np.isnan(xyz_m).any(-1).astype(float)) > 0
        return np.where(lacks[..., None], np.nan, np.einsum("sj,fjk->fsk", weights, known))

    length_m = np.linalg.norm(weighted(masses.length), axis=-1)
    along_m = weighted(masses.start + masses.centre[:, None] * masses.axis)
    return along_m + length_m[..., None] * np.einsum("fsij,sj->fsi", turns, masses.aside), length_m


def _angular_momentum(
    masses: SegmentMasses,
    arms_m: Float[np.ndarray, "frames segments 3"],
    length_m: Float[np.ndarray, "frames segments"],
    turns: Float[np.ndarray, "frames segments 3 3"],
    window: int,
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames 3"]:
    """Angular momentum about the centre of mass for each kilogram: of the centres, and of the segments about them."""
    num_frames, num_segments = length_m.shape
    velocity_m_s = _velocity(arms_m.reshape(num_frames, -1), window, frame_rate_hz).reshape(arms_m.shape)
    orbital = np.cross(arms_m, velocity_m_s)
    rows = np.arange(num_frames)
    before, after = np.maximum(rows - 1, 0), np.minimum(rows + 1, num_frames - 1)
    steps = turns[after] @ np.swapaxes(turns[before], -1, -2)
    span_s = np.maximum(after - before, 1)[:, None, None] / frame_rate_hz
    rate_rad_s = Rotation.from_matrix(steps.reshape(-1, 3, 3)).as_rotvec().reshape(num_frames, num_segments, 3) / span_s
    inertia_m2 = (masses.radii * length_m[..., None]) ** 2
    local = np.einsum("fsji,fsj->fsi", turns, rate_rad_s)
    own = np.einsum("fsij,fsj->fsi", turns, inertia_m2 * local)
    return np.asarray(np.einsum("s,fsk->fk", masses.mass, orbital + own))


def _window(num_frames: int, frame_rate_hz: float) -> int:
    """Odd number of frames of a fit; 1 for tracks that are too short for any."""
    wanted = max(2 * round(_WINDOW_S * frame_rate_hz / 2) + 1, _MIN_FRAMES)
    return wanted if wanted <= num_frames else (num_frames - 1) // 2 * 2 + 1


def _velocity(
    values: Float[np.ndarray, "frames columns"], window: int, rate_hz: float
) -> Float[np.ndarray, "frames columns"]:
    """Slopes of parabolas through the frames around each one (Savitzky and Golay 1964); NaN where the value is."""
    if window < 3:
        return np.full(values.shape, np.nan)
    rows, filled = np.arange(len(values)), np.array(values)
    for column in filled.T:
        known = np.isfinite(column)
        column[:] = np.interp(rows, rows[known], column[known]) if known.any() else 0.0
    # SciPy's own filter is in ``scipy.signal``, whose import takes half a second of processor time.
    step_s, half = 1.0 / rate_hz, window // 2
    weights = lstsq(np.arange(half, -half - 1, -1.0) ** np.arange(3.0)[:, None], [0.0, 1.0 / step_s, 0.0])[0]
    slopes = convolve1d(filled, weights, axis=0, mode="constant")
    times = np.arange(float(window))
    for edge, at in (slice(window), slice(half)), (slice(-window, None), slice(-half, None)):
        square, linear, _ = np.polyfit(times, filled[edge], 2)
        slopes[at] = (2.0 * square * times[at, None] + linear) / step_s
    return np.where(np.isfinite(values), slopes, np.nan)


def _margins(
    track: Track3D, joints: JointSet, contacts: Sequence[FootContact], points_m: Float[np.ndarray, "frames 2"]
) -> Float[np.ndarray, " frames"]:
    """Distances of points on the floor from the border of the base of support, negative outside."""
    margin_m = np.full(len(points_m), np.nan)
    if not {f"{side}_{mark}" for side in SIDES for mark in ("heel", "big_toe")} <= set(joints.names):
        return margin_m
    stands: Bool[np.ndarray, "frames 2"] = np.zeros((len(points_m), 2), bool)
    for contact in contacts:
        stands[contact.rows, SIDES.index(contact.side)] = True
    marks = [[joints.index(f"{side}_{mark}") for mark in ("heel", "big_toe")] for side in SIDES]
    feet_m = track.xyz_m[:, marks, :2]
    along_m = feet_m[:, :, 1] - feet_m[:, :, 0]
    half_m = _BREADTH / 2 * np.stack([-along_m[..., 1], along_m[..., 0]], axis=-1)[:, :, None]
    corners_m = np.concatenate([feet_m + half_m, feet_m - half_m], axis=2)
    # A foot in the air has the corners of the other one.
    for side in range(2):
        corners_m[~stands[:, side], side] = corners_m[~stands[:, side], 1 - side]
    used = stands.any(1) & np.isfinite(corners_m).all((1, 2, 3)) & np.isfinite(points_m).all(1)
    rows = np.flatnonzero(used)
    for block in np.split(rows, range(_BLOCK_FRAMES, len(rows), _BLOCK_FRAMES)):
        margin_m[block] = margins_of(corners_m[block].reshape(-1, 8, 2), points_m[block])
    return margin_m


def margins_of(
    corners_m: Float[np.ndarray, "rows corners 2"], points_m: Float[np.ndarray, "rows 2"]
) -> Float[np.ndarray, " rows"]:
    """Distances of points from the borders of the convex hulls of corners, negative outside.

    >>> square = np.array([[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]])
    >>> margins_of(square, np.array([[0.5, 1.0]])), margins_of(square, np.array([[3.0, 3.0]])).round(6)
    (array([0.5]), array([-1.414214]))
    """

    def crossed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])

    # Lines between two corners with all corners on their left are the border, counterclockwise.
    starts, ends = np.nonzero(~np.eye(corners_m.shape[1], dtype=bool))
    edge_m = corners_m[:, ends] - corners_m[:, starts]
    length_m = np.linalg.norm(edge_m, axis=-1)
    is_line = length_m > _SAME_M
    unit = edge_m / np.maximum(length_m, _SAME_M)[..., None]
    others_m = crossed(unit[:, :, None], corners_m[:, None] - corners_m[:, starts, None])
    is_border = is_line & (others_m > -_SAME_M).all(-1)
    offset_m = points_m[:, None] - corners_m[:, starts]
    along_m = np.clip((offset_m * unit).sum(-1), 0.0, length_m)
    apart_m = np.linalg.norm(offset_m - along_m[..., None] * unit, axis=-1).min(1)
    depth_m = np.where(is_border, crossed(unit, offset_m), np.inf).min(1)
    return np.where(depth_m >= 0.0, depth_m, -apart_m)
