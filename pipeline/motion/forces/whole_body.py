"""Segments of a body in motion, and the force and moment that move all of them (Newton and Euler).

Each segment has the mass and inertia of ``pipeline.motion.balance.segment_masses``. Its centre follows the path of
``smoothing``, with one smoother a world axis for all segments, so that their accelerations add up to the body's.
A body in the air falls freely: this holds for its path in flights, which moves all segments alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.angles.compute import segments_from
from pipeline.motion.balance.compute import GRAVITY_M_S2, segment_centres
from pipeline.motion.balance.segment_masses import segment_masses
from pipeline.motion.forces.smoothing import likeliest
from pipeline.motion.skeleton.model import INDEX, forward_kinematics
from pipeline.motion.skeleton.time_series import filled_with_body

UP = np.array([0.0, 0.0, GRAVITY_M_S2])
_MIN_FRAMES = 12
# Time in which errors of joints forget each other, and time over which movements near the cutoff count, by simulated
# people and public plates (docs/lab/forces-notes.md).
_MEMORY_S, _IMPACT_S = 0.14, 0.08
# Deviation in flights, by the same.
_FALL_M_S2 = 0.03 * GRAVITY_M_S2
# Usual error of a marker on the skin (Peters et al., "Quantification of soft tissue artifact in lower limb human motion
# analysis: a systematic review", Gait & Posture 31, 2010). Its share in the body's acceleration, by which it swings
# after impacts.
_SKIN_M, _SWINGING = 0.005, 0.1
_EARS = tuple(f"{side}_ear" for side in SIDES)


@dataclass(frozen=True, slots=True, eq=False)
class BodyInMotion:
    """Segments of a body over the frames of its track, for each kilogram of its mass."""

    names: tuple[str, ...]  # Segments, as in ``body_segments.SEGMENTS``
    share: Float[np.ndarray, " segments"]  # Of the body's mass
    centre_m: Float[np.ndarray, "frames segments 3"]
    acceleration_m_s2: Float[np.ndarray, "frames segments 3"]
    # Change of the angular momentum of a segment about its centre, for each kilogram of the body
    spin: Float[np.ndarray, "frames segments 3"]
    turns: Mapping[str, Float[np.ndarray, "frames 3 3"]]  # ``world_from_segment``
    rate_rad_s: Mapping[str, Float[np.ndarray, "frames 3"]]  # Angular velocities in the world
    xyz_m: Float[np.ndarray, "frames joints 3"]  # Joints without gaps
    known: Bool[np.ndarray, " frames"]  # Frames in which the body's centre is known
    sigma: Float[np.ndarray, "frames 3"]  # Standard deviation of the body's acceleration
    raw_m_s2: Float[np.ndarray, "frames 3"]  # Acceleration of the body without the free fall of flights

    @property
    def force(self) -> Float[np.ndarray, "frames 3"]:
        """Force on the body beside gravity."""
        return np.asarray(np.einsum("s,fsk->fk", self.share, self.acceleration_m_s2) + UP)

    @property
    def body_m(self) -> Float[np.ndarray, "frames 3"]:
        """Centre of mass."""
        return np.asarray(np.einsum("s,fsk->fk", self.share, self.centre_m))

    def moment(
        self, place_m: Float[np.ndarray, "frames 3"], segments: Bool[np.ndarray, " segments"] | None = None
    ) -> Float[np.ndarray, "frames 3"]:
        """Moment about a place that moves segments, beside gravity's; ``None``: all segments."""
        chosen = np.ones(len(self.names), bool) if segments is None else segments
        forces = self.share[chosen, None] * (self.acceleration_m_s2[:, chosen] + UP)
        arms_m = self.centre_m[:, chosen] - place_m[:, None]
        return np.asarray((np.cross(arms_m, forces) + self.spin[:, chosen]).sum(1))


def body_in_motion(
    motion: SkeletonMotion,
    track: Track3D,
    joints: JointSet,
    subject: Subject,
    flies: Bool[np.ndarray, " frames"],
) -> BodyInMotion | None:
    """Segments of a person in motion.

    The deviation of the acceleration has four parts: noise, errors that last, the table of segments, and movements
    faster than the cutoff. Of the last ones, the octave below the cutoff tells: an impact carries about as much above.
    Markers, which state no deviation, swing on the skin as well.

    ``flies``: frames in which the body surely touches nothing. ``None`` if joints of the body are
    missing, or the track is too short.
    """
    if not {*_EARS} <= {*joints.names} or track.num_frames < _MIN_FRAMES:
        return None
    xyz_m = np.array(track.xyz_m, dtype=float)
    ears = joints.indices(_EARS)
    if not np.isfinite(xyz_m[:, ears]).all(-1).any():
        # A head without marks is where the skeleton has it.
        skeleton_m = forward_kinematics(motion)
        xyz_m[:, ears] = skeleton_m[:, [INDEX["Head"], INDEX["HeadEnd"]]].mean(1)[:, None]
    masses, other = (segment_masses(subject._replace(table=table), joints, xyz_m) for table in _tables(subject))
    if masses is None or other is None:
        return None
    used = (masses.weights != 0) | (masses.axis != 0).any(0)
    known = np.isfinite(xyz_m[:, masses.weights != 0]).all((1, 2))
    filled_m = filled_with_body(xyz_m[:, used])
    if known.sum() < _MIN_FRAMES or not np.isfinite(filled_m).all():
        return None
    xyz_m[:, used] = filled_m
    rate_hz = motion.frame_rate_hz
    world_from_segment = segments_from(motion)
    pose = np.stack([world_from_segment[name] for name in masses.orientations], axis=1)
    centre_m, length_m = segment_centres(masses, xyz_m, pose)
    body_m = np.einsum("s,fsk->fk", masses.mass, centre_m)
    other_pose = np.stack([world_from_segment[name] for name in other.orientations], axis=1)
    other_m = np.einsum("s,fsk->fk", other.mass, segment_centres(other, xyz_m, other_pose)[0])
    stated = np.full(xyz_m.shape[:2], np.nan) if track.uncertainty_m is None else track.uncertainty_m
    joint_m = np.where(np.isfinite(stated), stated, _SKIN_M)
    stated_m = np.sqrt((masses.weights**2 * joint_m**2).sum(1))
    lags = np.arange(round(4 * _MEMORY_S * rate_hz) + 1)
    correlation = np.exp(-0.5 * (lags / (_MEMORY_S * rate_hz)) ** 2)
    path_m, fallen_m, sigma, raw = np.empty_like(centre_m), np.empty_like(body_m), np.empty_like(body_m), []
    smoothers = []
    for axis in range(3):
        smoother, noise_m = likeliest(body_m[:, [axis]], known, rate_hz)
        path_m[..., axis] = smoother.path(centre_m[..., axis])
        raw.append(smoother.acceleration(path_m[..., axis] @ masses.mass))
        slower = replace(smoother, penalty=2.0**6 * smoother.penalty)
        fallen_m[:, axis], slow_m = (of.path_with_falls(body_m, noise_m, flies)[:, axis] for of in (smoother, slower))
        beyond = _size_around(smoother.acceleration(fallen_m[:, axis] - slow_m), rate_hz)
        white, lasting = smoother.acceleration_gains(correlation).T
        # Tables of other bodies: half of the difference of two of them is the deviation of one.
        table = smoother.acceleration(smoother.path(other_m[:, axis] - body_m[:, axis])) / 2.0
        sigma[:, axis] = np.sqrt((white * noise_m) ** 2 + (lasting * stated_m) ** 2 + table**2 + beyond**2)
        smoothers.append(smoother)
    path_m += (fallen_m - np.einsum("s,fsk->fk", masses.mass, path_m))[:, None]
    acceleration = np.stack([smoothers[axis].acceleration(path_m[..., axis]) for axis in range(3)], axis=-1)
    if track.uncertainty_m is None:
        size = np.linalg.norm(np.einsum("s,fsk->fk", masses.mass, acceleration), axis=1)
        sigma = np.hypot(sigma, _SWINGING * _size_around(size, rate_hz)[:, None])
    sigma[flies] = np.minimum(sigma[flies], _FALL_M_S2)
    rates = {name: _rates(turn, rate_hz) for name, turn in world_from_segment.items()}
    inertia_m2 = (masses.radii * np.median(length_m, axis=0)[:, None]) ** 2 * masses.mass[:, None]
    omega = np.stack([rates[name] for name in masses.orientations], axis=1)
    own_spin = np.einsum("fsij,sj,fskj,fsk->fsi", pose, inertia_m2, pose, omega)
    # The integral of the angular momentum is smoothed like positions, so that its second derivative is the moment.
    summed = np.cumsum(own_spin, axis=0) / rate_hz
    spin = np.stack(
        [smoothers[axis].acceleration(smoothers[axis].path(summed[..., axis])) for axis in range(3)], axis=-1
    )
    return BodyInMotion(
        masses.orientations,
        masses.mass,
        path_m,
        acceleration,
        spin,
        world_from_segment,
        rates,
        xyz_m,
        known,
        sigma,
        np.stack(raw, axis=1),
    )


def _tables(subject: Subject) -> tuple[str, str]:
    """Table of a person, and the other one."""
    return (subject.table, "dumas" if subject.table == "de-leva" else "de-leva")


def _size_around(values: Float[np.ndarray, " frames"], rate_hz: float) -> Float[np.ndarray, " frames"]:
    """Root mean square around each frame."""
    return np.asarray(np.sqrt(gaussian_filter1d(values**2, _IMPACT_S * rate_hz, mode="nearest")))


def _rates(turns: Float[np.ndarray, "frames 3 3"], rate_hz: float) -> Float[np.ndarray, "frames 3"]:
    """Angular velocities in the world's axes, by central differences."""
    rows = np.arange(len(turns))
    before, after = np.maximum(rows - 1, 0), np.minimum(rows + 1, len(turns) - 1)
    steps = turns[after] @ np.swapaxes(turns[before], -1, -2)
    return np.asarray(Rotation.from_matrix(steps).as_rotvec() * (rate_hz / (after - before))[:, None])
