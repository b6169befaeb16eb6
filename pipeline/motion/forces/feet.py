"""Shares of the feet in the force on a body, and where each foot carries it.

One foot on the ground carries all, at the place that the moment on the body tells, within its sole. Two feet carry it
at places that roll from heel to toe in a step: over its double support to the toes of the foot behind, and from the
heel of the foot in front. The vertical force is shared so that its common place is right; then places in front of the
ball of a foot are moved back to it. Forces of both feet pass
through a point above the common place, as high as the centre of mass: their horizontal parts follow (the virtual pivot
point of Maus et al., "Upright human gait did not provide a major mechanical challenge for our ancestors", Nat. Commun.
1, 2010).

A force that passes outside the soles for a while has another contact. If the thighs are level, a seat below the hips
carries the share that brings the common place there. Else hands, or another person, carry an unknown share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.smoothing import PathSmoother, penalty_of
from pipeline.motion.forces.whole_body import BodyInMotion
from pipeline.motion.gait.events import Swing, find_swings
from pipeline.motion.gait.movements import find_flights, find_movements
from pipeline.motion.gait.points import body_points
from pipeline.motion.skeleton.feet.floor import find_runs

# Time about a foot's strike and off in which it may be on the ground or not: their largest usual error.
_EDGE_S = 0.03
# Longest stance of a step; time before and after the end of a contact in which the foot leaves the ground; cutoff of
# the acceleration of a mark.
_LONGEST_S, _OFF_S, _MARK_HZ = 1.5, (0.05, 0.12), 10.0
# Least vertical force, as a share of body weight, that something under the feet carries; below it a foot is unloaded.
_CARRIED, _UNLOADED = 0.25, 0.05
# Half of a foot's breadth, as a share of its length (Drillis and Contini 1966).
_HALF_BREADTH = 0.18
# Places in lengths of the foot from heel to toe, and aside, of a body that stands on both feet.
_STANDING = 0.5, 0.0
# Distance of the force from the soles at which something else carries, and its time; distance at which this begins.
# Walks, runs, squats and jumps stay below 0.11 m over this time, seats have 0.24 and more (docs/lab/forces-notes.md).
_OUTSIDE_M, _OUTSIDE_S, _AT_SOLE_M = 0.15, 0.3, 0.03
# Sine of the largest slope of thighs on a seat.
_LEVEL = 0.5
# Farthest place of the force on a foot: plates have 0.72 to 0.83 under a foot alone, and 0.8 to 0.96 as it leaves.
_BALL = 0.85
# Standard deviations, in simulation and by public plates (docs/lab/forces-notes.md): of a foot's share in the middle of
# a double support, of its place as a share of the foot's length, and of the centre of mass by tables.
_SPLIT, _PATH, BODY_M = 0.05, 0.1, 0.025
# Deviation of a place anywhere on a foot, as a share of its length.
_ANYWHERE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Stances:
    """Feet on the ground in the frames of a track; columns are left and right."""

    stands: Bool[np.ndarray, "frames 2"]
    flies: Bool[np.ndarray, " frames"]  # Surely in the air, between an off and a strike


def find_stances(motion: SkeletonMotion, track: Track3D, joints: JointSet) -> Stances:
    """Frames in which feet stand, by contacts and by swings between them, and in which the body flies.

    A contact ends where the toe, or the ankle without a toe, is accelerated upwards most (Hreljac and Stergiou, "Phase
    determination during normal running using kinematic data", Med. Biol. Eng. Comput. 38, 2000).
    """
    num_frames, rate_hz = track.num_frames, motion.frame_rate_hz
    stands = np.zeros((num_frames, 2), bool)
    for contact in motion.contacts:
        stands[contact.rows, SIDES.index(contact.side)] = True
    points = body_points(track, joints, rate_hz)
    swings = () if points is None else find_swings(points)
    flies = np.zeros(num_frames, bool)
    for start, stop in () if points is None else find_flights(points):
        flies[start:stop] = True
    for move in () if points is None else find_movements(points):
        if move.kind == "jump":
            flies[int(np.ceil(move.start_row)) : int(np.floor(move.end_row)) + 1] = True
    for column, side in enumerate(SIDES):
        _step(stands[:, column], [swing for swing in swings if swing.side == side], rate_hz)
        marks = [joints.index(name) for name in (f"{side}_big_toe", f"{side}_ankle") if name in joints.names]
        mark = next((mark for mark in marks if np.isfinite(track.xyz_m[:, mark]).any()), marks[-1])
        _end_at_rise(stands[:, column], track.xyz_m[:, mark, 2], rate_hz)
    strikes = [swing.strike.row for swing in swings if swing.strike is not None]
    for start, stop in find_runs(np.asarray(~stands.any(1))):
        # A gap between contacts is a flight if a foot strikes at its end; feet that land on the toes strike late.
        if start and not flies[start:stop].any() and any(abs(row - stop) <= 2.0 * _EDGE_S * rate_hz for row in strikes):
            flies[start:stop] = True
    stands &= ~flies[:, None]
    edges = np.ones(2 * max(round(_EDGE_S * rate_hz), 1) + 1, bool)
    return Stances(stands, binary_erosion(flies, edges, border_value=True))


def _step(stands: Bool[np.ndarray, " frames"], swings: Sequence[Swing], rate_hz: float) -> None:
    """Mark the stances between the swings of a foot, in place."""
    edge = round(2 * _EDGE_S * rate_hz)
    for before, after in pairwise(swings):
        struck, off = before.strike, after.off
        if struck is not None and off is not None and off.row - struck.row < _LONGEST_S * rate_hz:
            stands[round(struck.row) : round(off.row) + 1] = True
    for swing in swings:
        if swing.strike is not None:
            first = round(swing.strike.row)
            stands[max(first - edge, 0) : first] = False
            stands[first : first + edge] = True
        if swing.off is not None:
            last = round(swing.off.row)
            stands[max(last - edge, 0) : last + 1] = True


def _end_at_rise(stands: Bool[np.ndarray, " frames"], height_m: Float[np.ndarray, " frames"], rate_hz: float) -> None:
    """Move the ends of stances to the largest upward acceleration of a mark, in place."""
    known = np.isfinite(height_m)
    if known.sum() < 4:
        return
    smoother = PathSmoother(known, penalty_of(_MARK_HZ, rate_hz), rate_hz)
    rise_m_s2 = smoother.acceleration(smoother.path(height_m[:, None]))[:, 0]
    before, after = (round(time_s * rate_hz) for time_s in _OFF_S)
    for _, stop in find_runs(stands.copy()):
        if stop < len(stands):
            first = max(stop - before, 0)
            off = first + int(rise_m_s2[first : stop + after].argmax())
            stands[min(off, stop) : stop] = False
            stands[stop - 1 : off] = True


@dataclass(frozen=True, slots=True, eq=False)
class FootForces:
    """Forces of the ground on the feet, for each kilogram of the body; columns are left and right."""

    stands: Bool[np.ndarray, "frames 2"]
    force: Float[np.ndarray, "frames 2 3"]  # 0 without contact
    pressure_m: Float[np.ndarray, "frames 2 3"]  # Centre of pressure; NaN without contact
    free_moment: Float[np.ndarray, "frames 2"]  # About the vertical through the centre of pressure
    sigma: Float[np.ndarray, "frames 2 3"]  # Of the force
    pressure_sigma_m: Float[np.ndarray, "frames 2"]
    measured: Bool[np.ndarray, "frames 2"]  # True where a force plate measured them
    seated: Bool[np.ndarray, " frames"]  # A seat carries what the feet don't
    undetermined: Bool[np.ndarray, " frames"]  # Something unknown carries, too: forces of feet are NaN


def split(
    body: BodyInMotion, stances: Stances, joints: JointSet, floor: Floor | None, frame_rate_hz: float
) -> FootForces:
    """Share the force on a body among its feet and a seat."""
    num_frames, force = len(body.known), body.force
    heels_m, toes_m = foot_marks(body, joints)
    stands = stances.stands.copy()
    # Something under the feet carries a body that does not fall: the lower foot.
    carries = (force[:, 2] > _CARRIED * GRAVITY_M_S2) & ~stances.flies & ~stands.any(1)
    stands[carries, np.minimum(heels_m[..., 2], toes_m[..., 2]).argmin(1)[carries]] = True
    stands &= (force[:, 2] > _UNLOADED * GRAVITY_M_S2)[:, None]
    ground_m = _ground(np.stack([heels_m, toes_m]).mean(0), floor)
    total_m = _pressure(body, force, ground_m.mean(1))
    on_foot = np.stack([_on_foot(total_m, heels_m[:, k], toes_m[:, k]) for k in range(2)], axis=1)
    both = np.asarray(stands.all(1))
    for start, stop in find_runs(both):
        _roll(on_foot, stands, start, stop)
    pressure_m = _placed(on_foot, heels_m, toes_m)
    gap_m = (pressure_m[:, 1] - pressure_m[:, 0])[:, :2]
    along = ((total_m - pressure_m[:, 0])[:, :2] * gap_m).sum(1) / np.maximum((gap_m**2).sum(1), 1e-4)
    right = np.where(both, np.clip(along, 0.0, 1.0), stands[:, 1])
    share = np.stack([np.where(both, 1.0 - right, stands[:, 0]), right], axis=1)
    # A rest beside the line between both places moves both, within the soles.
    rest_m = total_m - (share[..., None] * pressure_m).sum(1)
    moved_m = pressure_m + np.where(both[:, None], rest_m, 0.0)[:, None]
    moved = np.stack([_on_foot(moved_m[:, k], heels_m[:, k], toes_m[:, k]) for k in range(2)], axis=1)
    on_foot = np.where(both[:, None, None], moved, on_foot)
    pressure_m = _placed(on_foot, heels_m, toes_m)
    pressure_m[..., 2] = ground_m
    common_m = (share[..., None] * pressure_m).sum(1)
    beyond_m = (total_m - common_m)[:, :2] * np.asarray(stands.any(1))[:, None]
    beyond = _lasting(np.linalg.norm(beyond_m, axis=1), frame_rate_hz)
    on_seat, seated, apart_m = _seat(body, joints, common_m, beyond_m)
    seated &= beyond
    height_m = np.maximum(body.body_m[:, 2] - ground_m.mean(1), 0.3)
    split_force = share[..., None] * force[:, None]
    lean = (common_m[:, None] - pressure_m)[..., :2] / height_m[:, None, None]
    split_force[..., :2] += np.where(both[:, None, None], split_force[..., 2:] * lean, 0.0)
    # Of a foot whose heel rises, the ball carries: a place in front of it is an error of the body's centre.
    pressure_m = _placed(np.minimum(on_foot, _BALL), heels_m, toes_m)
    pressure_m[..., 2], pressure_m[~stands] = ground_m, np.nan
    free = np.where(stands.any(1) & ~beyond, _free_moment(body, split_force, pressure_m), 0.0)
    loose = _SPLIT * 2.0 * np.sqrt(share * (1.0 - share)) * both[:, None]
    sigma = np.hypot(share[..., None] * body.sigma[:, None], loose[..., None] * np.abs(force[:, None]))
    lever = height_m / np.maximum(force[:, 2], 0.1 * GRAVITY_M_S2)
    length_m = np.linalg.norm((toes_m - heels_m)[..., :2], axis=-1)
    of_body_m = np.hypot(np.linalg.norm(body.sigma[:, :2], axis=1) / np.sqrt(2.0) * lever, BODY_M)
    path = np.where(seated, _ANYWHERE, _PATH * both)
    pressure_sigma_m = np.hypot(of_body_m[:, None], path[:, None] * length_m)
    of_seat = share * np.where(seated, of_body_m / apart_m, 0.0)[:, None]
    sigma = np.hypot(sigma, of_seat[..., None] * np.abs(force[:, None]))
    sigma[~stands], pressure_sigma_m[~stands] = 0.0, np.nan
    undetermined, free_moment = beyond & ~seated, free[:, None] * share
    split_force *= np.where(seated, 1.0 - on_seat, 1.0)[:, None, None]
    for values in (split_force, pressure_m, free_moment, sigma, pressure_sigma_m):
        values[undetermined] = np.nan
    measured = np.zeros((num_frames, 2), bool)
    return FootForces(
        stands, split_force, pressure_m, free_moment, sigma, pressure_sigma_m, measured, seated, undetermined
    )


def _seat(
    body: BodyInMotion,
    joints: JointSet,
    feet_m: Float[np.ndarray, "frames 3"],
    beyond_m: Float[np.ndarray, "frames 2"],
) -> tuple[Float[np.ndarray, " frames"], Bool[np.ndarray, " frames"], Float[np.ndarray, " frames"]]:
    """Share of a seat below the hips, frames in which there may be one, and its distance from the feet.

    ``beyond_m``: way from the feet's place to the place of the force.
    """
    hips_m, knees_m = (
        body.xyz_m[:, joints.indices(tuple(f"{side}_{name}" for side in SIDES))].mean(1) for name in ("hip", "knee")
    )
    thigh_m, seat_m = hips_m - knees_m, (hips_m - feet_m)[:, :2]
    apart_m = np.maximum(np.linalg.norm(seat_m, axis=1), 0.1)
    on_seat = np.clip((beyond_m * seat_m).sum(1) / apart_m**2, 0.0, 1.0)
    is_level = thigh_m[:, 2] < _LEVEL * np.linalg.norm(thigh_m, axis=1)
    return on_seat, is_level & (np.linalg.norm(beyond_m - on_seat[:, None] * seat_m, axis=1) < _OUTSIDE_M), apart_m


def _lasting(outside_m: Float[np.ndarray, " frames"], rate_hz: float) -> Bool[np.ndarray, " frames"]:
    """Frames in which a force passes outside the soles, around times in which it does so far and long."""
    lasts = np.zeros(len(outside_m), bool)
    for start, stop in find_runs(outside_m > _AT_SOLE_M):
        far = find_runs(outside_m[start:stop] > _OUTSIDE_M)
        lasts[start:stop] = any(last - first >= _OUTSIDE_S * rate_hz for first, last in far)
    return lasts


def _roll(on_foot: np.ndarray, stands: Bool[np.ndarray, "frames 2"], start: int, stop: int) -> None:
    """Centres of pressure in a double support, in place; a body that keeps standing has them in the middle."""
    before = stands[start - 1] if start else np.ones(2, bool)
    after = stands[stop] if stop < len(stands) else np.ones(2, bool)
    steps = before.sum() == 1 or after.sum() == 1
    if not steps or (before == after).all():
        on_foot[start:stop] = _STANDING
        return
    # At an end of the take, half of the double support is there.
    past = np.linspace(0.0 if start else 0.5, 1.0 if stop < len(stands) else 0.5, stop - start + 2)[1:-1, None]
    behind = int(before.argmax()) if before.sum() == 1 else int((~after).argmax())
    first = on_foot[start - 1, behind] if start else np.array(_STANDING)
    last = on_foot[stop, 1 - behind] if stop < len(stands) else np.array(_STANDING)
    on_foot[start:stop, behind] = first + past * ([1.0, 0.0] - first)
    on_foot[start:stop, 1 - behind] = past * last


def foot_marks(body: BodyInMotion, joints: JointSet) -> tuple[np.ndarray, np.ndarray]:
    """Heels and toes; the ankles, and a point in front of them, where a detector has no marks of the feet."""
    names = set(joints.names)
    heels, toes = [], []
    for side in SIDES:
        ankle_m = body.xyz_m[:, joints.index(f"{side}_ankle")]
        marks = [f"{side}_heel", f"{side}_big_toe"]
        placed = [body.xyz_m[:, joints.index(mark)] for mark in marks if mark in names]
        if len(placed) == 2 and all(np.isfinite(mark_m).all() for mark_m in placed):
            heels.append(placed[0])
            toes.append(placed[1])
        else:
            ahead = body.turns[f"{side}_foot"][..., 0] * 0.15
            heels.append(ankle_m - ahead / 3.0)
            toes.append(ankle_m + ahead)
    return np.stack(heels, axis=1), np.stack(toes, axis=1)


def _ground(feet_m: Float[np.ndarray, "frames 2 3"], floor: Floor | None) -> Float[np.ndarray, "frames 2"]:
    """Height of the ground under the feet; without a floor, of the lowest marks."""
    if floor is not None:
        return np.asarray(feet_m[..., 2] - floor.height_m(feet_m))
    return np.full(feet_m.shape[:2], float(np.quantile(feet_m[..., 2].min(1), 0.05)))


def _pressure(
    body: BodyInMotion, force: Float[np.ndarray, "frames 3"], ground_m: Float[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames 3"]:
    """Place on the ground through which the force passes, so that it turns about the vertical at most."""
    place_m = np.stack([*body.body_m[:, :2].T, ground_m], axis=1)
    moment = body.moment(place_m)
    vertical = np.maximum(force[:, 2], _UNLOADED * GRAVITY_M_S2)
    return np.asarray(place_m + np.stack([-moment[:, 1], moment[:, 0], 0.0 * vertical], axis=1) / vertical[:, None])


def _on_foot(
    place_m: Float[np.ndarray, "frames 3"], heel_m: Float[np.ndarray, "frames 3"], toe_m: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 2"]:
    """Place along a foot, 0 at the heel and 1 at the toes, and aside in lengths of the foot, inside its sole."""
    along_m = (toe_m - heel_m)[:, :2]
    aside_m = np.stack([-along_m[:, 1], along_m[:, 0]], axis=1)
    square = np.maximum((along_m**2).sum(1), 1e-4)
    offset_m = (place_m - heel_m)[:, :2]
    along, aside = ((offset_m * axis_m).sum(1) / square for axis_m in (along_m, aside_m))
    return np.stack([np.clip(along, 0.0, 1.0), np.clip(aside, -_HALF_BREADTH, _HALF_BREADTH)], axis=1)


def _placed(
    on_foot: Float[np.ndarray, "frames 2 2"],
    heels_m: Float[np.ndarray, "frames 2 3"],
    toes_m: Float[np.ndarray, "frames 2 3"],
) -> Float[np.ndarray, "frames 2 3"]:
    """Inverse of ``_on_foot``."""
    along_m = toes_m - heels_m
    aside_m = np.stack([-along_m[..., 1], along_m[..., 0], 0.0 * along_m[..., 0]], axis=-1)
    return np.asarray(heels_m + on_foot[..., :1] * along_m + on_foot[..., 1:] * aside_m)


def _free_moment(
    body: BodyInMotion, force: Float[np.ndarray, "frames 2 3"], pressure_m: Float[np.ndarray, "frames 2 3"]
) -> Float[np.ndarray, " frames"]:
    """Moment about the vertical that the forces of the feet leave."""
    arms_m = np.nan_to_num(pressure_m) - body.body_m[:, None]
    turned = np.cross(arms_m, force) * np.isfinite(pressure_m[..., :1])
    return np.asarray(body.moment(body.body_m)[:, 2] - turned.sum(1)[:, 2])
