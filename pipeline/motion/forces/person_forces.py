"""Forces of a person in a take: of the whole body and of the feet, moments and powers of joints, and their figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.body_mass import BodyMass, body_mass
from pipeline.motion.forces.feet import FootForces, find_stances, foot_marks, split
from pipeline.motion.forces.joint_moments import JointMoments, joint_moments
from pipeline.motion.forces.whole_body import BodyInMotion, body_in_motion
from pipeline.motion.gait.movements import find_movements
from pipeline.motion.gait.points import body_points
from pipeline.motion.laboratory.plates import LOADED_N, force_plates
from pipeline.motion.skeleton.feet.floor import find_runs

# Distance of joints of two people who may touch: half the breadth of two limbs and the error of both.
_TOUCHING_M = 0.15
# Largest distance of a centre of pressure from the middle of the foot that stands there.
_ON_FOOT_M = 0.25
# Least length of a stance that has figures, and share of body weight between which its force rises (Hreljac, Marshall
# and Hume, "Evaluation of lower extremity overuse injury potential in runners", Med. Sci. Sports Exerc. 32, 2000).
_STANCE_S, _RISE = 0.1, (0.2, 0.8)
_WEIGHT = GRAVITY_M_S2
LEAST_RATE_HZ = 20.0
"""Least rate of frames, which shows steps."""


@dataclass(frozen=True, slots=True, eq=False)
class PersonForces:
    """Forces of a person in the frames of the track for each kilogram of the body, or in newtons and newton metres.

    All is NaN in frames in which the centre of mass is unknown.
    """

    start_frame: int
    mass: BodyMass
    unit_kg: float  # Mass whose forces these are: 1, or in newtons the body's
    frame_rate_hz: float
    total: Float[np.ndarray, "frames 3"]  # Force on the body beside gravity
    total_sigma: Float[np.ndarray, "frames 3"]
    feet: FootForces
    joints: JointMoments
    flies: Bool[np.ndarray, " frames"]
    # Vertical force in flights before it is held at zero, as a share of body weight; NaN without a flight
    flight_residual: float
    touches: Bool[np.ndarray, " frames"]  # Another person is so near that an unknown force may act between both
    jump_heights_m: tuple[tuple[float, float, float | None], ...]  # Row of the take-off, height by impulse, by flight

    @property
    def frames(self) -> range:
        """Output frames of the rows."""
        return range(self.start_frame, self.start_frame + len(self.total))

    @property
    def weight(self) -> float:
        """Weight of the body in the unit of the forces."""
        return self.unit_kg * _WEIGHT

    def in_newtons(self) -> "PersonForces":
        """Forces of the whole mass, whose deviation is part of all deviations but of measured forces."""
        kg, share = self.mass.kg, self.mass.sigma_kg / self.mass.kg

        def scaled(values: np.ndarray) -> np.ndarray:
            return read_only(kg * values)

        def wider(sigma: np.ndarray, values: np.ndarray) -> np.ndarray:
            return read_only(kg * np.hypot(sigma, share * values))

        feet, joints = self.feet, self.joints
        sigma = np.where(feet.measured[..., None], kg * feet.sigma, wider(feet.sigma, feet.force))
        force, free_moment = scaled(feet.force), scaled(feet.free_moment)
        return replace(
            self,
            unit_kg=kg,
            total=scaled(self.total),
            total_sigma=wider(self.total_sigma, self.total),
            feet=replace(feet, force=force, sigma=read_only(sigma), free_moment=free_moment),
            joints=JointMoments(scaled(joints.moment), wider(joints.sigma, joints.moment), scaled(joints.power)),
        )


def forces_of(
    motion: SkeletonMotion,
    track: Track3D,
    joints: JointSet,
    subject: Subject,
    floor: Floor | None,
    others: Sequence[Track3D] = (),
    laboratory: Laboratory | None = None,
    timebase: Timebase | None = None,
) -> PersonForces | None:
    """Compute the forces of a person for each kilogram of the body.

    - ``motion``, ``track``: motion with the contacts of the feet, and final joints in the same frames.
    - ``subject``: table of segments, sex and mass; without a mass, the stature gives an estimate.
    - ``floor``: floor of the take.
    - ``others``: other people, who may touch the person.
    - ``laboratory``, ``timebase``: force plates whose clock is known, which replace the estimate at their feet.

    ``None`` if the detector lacks joints of the body, the track is shorter than twelve frames, or has fewer than 20 a
    second, which show no steps.
    """
    if motion.frame_rate_hz < LEAST_RATE_HZ:
        return None
    stances = find_stances(motion, track, joints)
    body = body_in_motion(motion, track, joints, subject, stances.flies)
    if body is None:
        return None
    feet = split(body, stances, joints, floor, motion.frame_rate_hz)
    if laboratory is not None and timebase is not None and laboratory.start is not None and subject.mass_kg:
        feet = _with_plates(feet, body, joints, track, laboratory, timebase, subject.mass_kg)
    moments = joint_moments(body, feet, joints)
    raw = 1.0 + body.raw_m_s2[stances.flies, 2] / _WEIGHT

    def where_known(values: Float[np.ndarray, "frames *columns"]) -> Float[np.ndarray, "frames *columns"]:
        values = np.array(values)
        values[~body.known] = np.nan
        return read_only(values)

    heights = tuple(_jump_heights(body, track, joints, motion.frame_rate_hz))
    return PersonForces(
        track.start_frame,
        body_mass(subject, motion),
        1.0,
        motion.frame_rate_hz,
        where_known(body.force),
        where_known(body.sigma),
        replace(
            feet,
            force=where_known(feet.force),
            pressure_m=where_known(feet.pressure_m),
            free_moment=where_known(feet.free_moment),
            sigma=where_known(feet.sigma),
            pressure_sigma_m=where_known(feet.pressure_sigma_m),
            stands=feet.stands & body.known[:, None],
            seated=feet.seated & body.known,
            undetermined=feet.undetermined & body.known,
        ),
        moments,
        stances.flies,
        float(raw.mean()) if len(raw) else np.nan,
        touching(track, others),
        heights,
    )


def touching(track: Track3D, others: Sequence[Track3D]) -> Bool[np.ndarray, " frames"]:
    """Frames in which a joint of a person is so near to another person's that both may touch."""
    touches = np.zeros(track.num_frames, bool)
    for other in others:
        first, stop = max(track.start_frame, other.start_frame), min(track.frames.stop, other.frames.stop)
        own_m, other_m = (of.xyz_m[first - of.start_frame : max(stop, first) - of.start_frame] for of in (track, other))
        # Boxes around the bodies tell quickly that most people are apart.
        lows, highs = ([end(of, axis=1) for of in (own_m, other_m)] for end in (np.fmin.reduce, np.fmax.reduce))
        gap_m = np.maximum(lows[0] - highs[1], lows[1] - highs[0])
        for row in np.flatnonzero((gap_m < _TOUCHING_M).all(1)):
            apart_m = np.linalg.norm(own_m[row, :, None] - other_m[row, None], axis=-1)
            touches[first - track.start_frame + row] |= bool((apart_m < _TOUCHING_M).any())
    return touches


def _with_plates(
    feet: FootForces,
    body: BodyInMotion,
    joints: JointSet,
    track: Track3D,
    laboratory: Laboratory,
    timebase: Timebase,
    mass_kg: float,
) -> FootForces:
    """Forces of the feet with the measured ones where a foot stands on a plate."""
    from scipy.integrate import cumulative_trapezoid  # noqa: PLC0415 - slow to import, and seldom needed

    heels_m, toes_m = foot_marks(body, joints)
    middle_m = (heels_m + toes_m)[..., :2] / 2.0
    start_s = laboratory.start.time_s if laboratory.start else 0.0
    time_s = timebase.start_time_s + np.array(track.frames) / timebase.frame_rate_hz - start_s
    half_s, step_s = 0.5 / timebase.frame_rate_hz, 1.0 / laboratory.sample_rate_hz
    own_s = np.arange(len(laboratory.samples)) * step_s

    def mean(values: Float[np.ndarray, "samples 3"]) -> Float[np.ndarray, "frames 3"]:
        """Means over the frames of the take."""
        summed = cumulative_trapezoid(values, dx=step_s, axis=0, initial=0.0)
        ends = [
            np.stack([np.interp(time_s + side, own_s, column) for column in summed.T], 1) for side in (-half_s, half_s)
        ]
        return np.asarray((ends[1] - ends[0]) / (2.0 * half_s))

    force, pressure_m, free = feet.force.copy(), feet.pressure_m.copy(), feet.free_moment.copy()
    measured, sums = np.zeros_like(feet.stands), np.zeros_like(feet.force)
    inside = (time_s > half_s) & (time_s < own_s[-1] - half_s)
    for plate in force_plates(laboratory):
        force_n, moment_nm, centre_m = mean(plate.force_n), mean(plate.moment_nm), plate.corners_m.mean(0)
        loaded = inside & (force_n[:, 2] > LOADED_N)
        safe_n = np.where(loaded, force_n[:, 2], 1.0)
        place_m = centre_m + np.stack([-moment_nm[:, 1], moment_nm[:, 0], 0.0 * safe_n], axis=1) / safe_n[:, None]
        apart_m = np.linalg.norm(middle_m - place_m[:, None, :2], axis=-1)
        foot = apart_m.argmin(1)
        rows = np.flatnonzero(loaded & (apart_m.min(1) < _ON_FOOT_M))
        on = foot[rows]
        before = sums[rows, on, 2:]
        total = before + force_n[rows, 2:]
        pressure_m[rows, on] = (
            np.nan_to_num(pressure_m[rows, on]) * before + place_m[rows] * force_n[rows, 2:]
        ) / total
        arm_m = (place_m - centre_m)[rows]
        turning = moment_nm[rows, 2] - (arm_m[:, 0] * force_n[rows, 1] - arm_m[:, 1] * force_n[rows, 0])
        free[rows, on] = np.where(measured[rows, on], free[rows, on], 0.0) + turning / mass_kg
        sums[rows, on] += force_n[rows]
        measured[rows, on] = True
    force[measured] = sums[measured] / mass_kg
    sigma, place_sigma_m = feet.sigma.copy(), feet.pressure_sigma_m.copy()
    sigma[measured], place_sigma_m[measured] = 0.0, 0.0
    return replace(
        feet,
        stands=feet.stands | measured,
        force=force,
        pressure_m=pressure_m,
        free_moment=free,
        sigma=sigma,
        pressure_sigma_m=place_sigma_m,
        measured=measured,
    )


def _jump_heights(
    body: BodyInMotion, track: Track3D, joints: JointSet, rate_hz: float
) -> list[tuple[float, float, float | None]]:
    """Row of each take-off, height by the velocity that the impulse gives, and height by the time of flight."""
    points = body_points(track, joints, rate_hz)
    heights = []
    velocity_m_s = np.gradient(body.body_m[:, 2], 1.0 / rate_hz)
    for move in () if points is None else find_movements(points):
        if move.kind == "jump":
            # In the middle of the flight, the velocity is known best; before it gravity alone acted.
            middle = round((move.start_row + move.end_row) / 2.0)
            up_m_s = velocity_m_s[middle] + _WEIGHT * (middle - move.start_row) / rate_hz
            heights.append((move.start_row, float(up_m_s**2 / (2.0 * _WEIGHT)), move.height_by_flight_m))
    return heights


def forces_document(forces: PersonForces, track_id: int) -> dict[str, Any]:
    """Figures of a person's forces, rounded, for ``metrics.json``."""
    weight = forces.weight
    stances: list[dict[str, Any]] = []
    for column, side in enumerate(SIDES):
        vertical = forces.feet.force[:, column, 2] / weight
        for start, stop in find_runs(np.asarray(forces.feet.stands[:, column])):
            is_whole = start > 0 and stop < len(vertical) and stop - start >= _STANCE_S * forces.frame_rate_hz
            # Next to frames in which the force is unknown, a stance is not whole.
            if not is_whole or not np.isfinite(vertical[start - 1 : stop + 1]).all():
                continue
            rows = vertical[start:stop]
            peak = int(rows.argmax())
            # The frame before has no force: a force that rises within a frame has the rate of this frame.
            first = vertical[start - 1 : start + _first_peak(rows) + 1]
            low, high = (int((first >= share * first.max()).argmax()) for share in _RISE)
            low = max(min(low, high - 1), 0)
            rising_s = max(high - low, 1) / forces.frame_rate_hz
            stances.append(
                {
                    "side": side,
                    "start_frame": forces.start_frame + start,
                    "num_frames": stop - start,
                    "impulse_bw_s": round(float(rows.sum() / forces.frame_rate_hz), 4),
                    "peak_bw": round(float(rows[peak]), 3),
                    "peak_sigma_bw": round(float(forces.feet.sigma[start + peak, column, 2] / weight), 3),
                    "loading_rate_bw_s": round(float((first[high] - first[low]) / rising_s), 2),
                    "is_measured": bool(forces.feet.measured[start:stop, column].all()),
                }
            )
    stances.sort(key=lambda stance: stance["start_frame"])
    asymmetry = {
        name: _asymmetry([stance[name] for stance in stances if stance["side"] == side] for side in SIDES)
        for name in ("impulse_bw_s", "peak_bw", "loading_rate_bw_s")
    }
    return {
        "id": track_id,
        "mass_kg": round(forces.mass.kg, 2),
        "mass_sigma_kg": round(forces.mass.sigma_kg, 2),
        "mass_is_estimated": forces.mass.is_estimated,
        "sigma_bw": _rounded(np.nanmedian(forces.total_sigma[:, 2]) / weight),
        "flight_residual_bw": _rounded(forces.flight_residual),
        "num_touching_frames": int(forces.touches.sum()),
        "num_seated_frames": int(forces.feet.seated.sum()),
        "num_undetermined_frames": int(forces.feet.undetermined.sum()),
        "stances": stances,
        "asymmetry_percent": asymmetry,
        "jumps": [
            {"frame": round(forces.start_frame + row), "by_impulse_m": _rounded(high), "by_flight_m": _rounded(flown)}
            for row, high, flown in forces.jump_heights_m
        ],
    }


def _first_peak(rows: Float[np.ndarray, " rows"]) -> int:
    """First local maximum above body weight, or the largest value."""
    inner = np.flatnonzero((rows[1:-1] >= rows[:-2]) & (rows[1:-1] > rows[2:]) & (rows[1:-1] > 1.0)) + 1
    return int(inner[0]) if len(inner) else int(rows.argmax())


def _asymmetry(sides: Any) -> float | None:
    """Difference of right and left over their mean, in percent (Robinson et al. 1987); ``None`` without both."""
    left, right = (float(np.mean(values)) if values else np.nan for values in sides)
    return round(200.0 * (right - left) / (right + left), 1) if right + left > 0.0 else None


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
