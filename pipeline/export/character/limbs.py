"""Limbs of characters: arms and legs that reach places, and feet that stand like the person's."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, FootContact
from pipeline.export.character.figure import FootMeasures
from pipeline.motion.skeleton.feet.floor import find_runs
from pipeline.motion.skeleton.feet.holding import eased
from pipeline.motion.skeleton.rotations import times

# Share of its length to which a limb is stretched.
REACH = 0.9999
_TINY = 1e-9


class BentLimb(NamedTuple):
    """Rotations of the two bones of a limb from the T-pose, and the place of its end."""

    upper: Float[np.ndarray, "frames 3 3"]
    lower: Float[np.ndarray, "frames 3 3"]
    end: Float[np.ndarray, "frames 3"]


def reach(
    start: Float[np.ndarray, "frames 3"],
    limb: BentLimb,
    along: Float[np.ndarray, " 3"],
    hinge: Float[np.ndarray, " 3"],
    lengths: tuple[float, float],
    place: Float[np.ndarray, "frames 3"],
    is_firm: bool,
) -> BentLimb:
    """Bend a limb and turn it so that its end is at a place, or as near as it reaches.

    The limb bends about its hinge, then turns as a whole by the smallest rotation. A limb that is there already stays
    as it is.

    ``start``: place of its first joint. ``along``, ``hinge``: direction of both bones in the T-pose, and axis about
    which a positive rotation bends the second one. ``lengths``: lengths of both bones. ``is_firm``: whether a limb that
    is bent beyond straight bends the other way if it does not reach the place else.
    """
    first, second = lengths
    upper, lower, axis = times(limb.upper, along), times(limb.lower, along), times(limb.upper, hinge)
    way = place - start
    distance = np.clip(np.linalg.norm(way, axis=-1), abs(first - second) * (2.0 - REACH), (first + second) * REACH)
    # Angle between both bones; what of the second one is not in the plane of the hinge is kept.
    cosine = (distance**2 - first**2 - second**2) / (2.0 * first * second)
    aside = np.einsum("fi,fi->f", lower, axis)
    in_plane = np.maximum(np.sqrt(np.maximum(1.0 - aside**2, 0.0)), _TINY)
    bent = np.arctan2(np.einsum("fi,fi->f", lower, np.cross(axis, upper)), np.einsum("fi,fi->f", lower, upper))
    wanted = np.arccos(np.clip(cosine / in_plane, -1.0, 1.0))
    if is_firm:
        # A limb that was bent beyond straight stays so, unless it has to bend much farther than it did.
        beyond = np.clip(-bent / np.maximum(wanted, _TINY) * 3.0 - 1.0, 0.0, 1.0)
        wanted = wanted * (1.0 - 2.0 * beyond * beyond * (3.0 - 2.0 * beyond))
    else:
        wanted = np.where(bent < 0.0, np.maximum(-wanted, bent), wanted)
    turned = Rotation.from_rotvec(axis * (wanted - bent)[:, None]).as_matrix()
    lower = np.einsum("fij,fj->fi", turned, lower)
    reached = first * upper + second * lower
    swung = swing_between(reached, way)
    end = start + np.einsum("fij,fj->fi", swung, reached)
    return BentLimb(swung @ limb.upper, swung @ turned @ limb.lower, end)


def swing_between(
    start: Float[np.ndarray, "frames 3"], end: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 3 3"]:
    """Smallest rotations from directions to other ones; the identity where one of them has no length."""
    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis, axis=-1), np.einsum("fi,fi->f", start, end)
    angle = np.arctan2(sine, cosine)
    # The axis of a half turn is any one at right angles.
    aside = np.cross(start, np.eye(3)[np.abs(start).argmin(-1)])
    is_flat = sine <= _TINY * np.linalg.norm(start, axis=-1) * np.linalg.norm(end, axis=-1)
    axis = np.where(is_flat[:, None], aside, axis)
    length = np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), _TINY)
    return Rotation.from_rotvec(axis / length * angle[:, None]).as_matrix()


def twist_rad(turn: Float[np.ndarray, "frames 3 3"], axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " frames"]:
    """Angles of rotations about an axis, their swing left out."""
    quat = Rotation.from_matrix(turn, assume_valid=True).as_quat()
    angle: np.ndarray = 2.0 * np.arctan2(quat[:, :3] @ axis, quat[:, 3])
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def between(
    start: Float[np.ndarray, "frames 3 3"],
    end: Float[np.ndarray, "frames 3 3"],
    share: float | Float[np.ndarray, " frames"],
) -> Float[np.ndarray, "frames 3 3"]:
    """Rotations on the shortest way from some to others; share 0 is the start."""
    way = Rotation.from_matrix(start.swapaxes(1, 2) @ end, assume_valid=True).as_rotvec()
    return start @ Rotation.from_rotvec(way * np.reshape(share, (-1, 1))).as_matrix()


_BACKWARD = np.array([0.0, 1.0, 0.0])
# Cosine of the tilt of a sole from which on it does not lie on the floor: the foot lies on its instep.
_MAX_TILT = 0.5
# Time in which a foot that stood flat comes to stand on its toes.
_LIFTS_S = 0.12
# Angles below the horizontal between which a foot turns over from toes up to toes back.
_STEEP_RAD = np.radians(55.0), np.radians(75.0)


class ScaledFloor(NamedTuple):
    """Floor in the character's unit: height at the origin, slopes along x and y."""

    z: float
    slopes: tuple[float, float]

    def height(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Vertical distance of points above the floor."""
        return np.asarray(points[..., 2] - self.z - points[..., :2] @ np.array(self.slopes))

    @property
    def up(self) -> Float[np.ndarray, " 3"]:
        """Unit vector at right angles to the floor."""
        normal = np.array([-self.slopes[0], -self.slopes[1], 1.0])
        return np.asarray(normal / np.linalg.norm(normal))


def scaled(floor: Floor | None, units_per_m: float) -> ScaledFloor | None:
    """Floor of a take in the character's unit."""
    return None if floor is None else ScaledFloor(floor.z_m * units_per_m, (floor.slope_x, floor.slope_y))


class FootPath(NamedTuple):
    """Path of a foot."""

    ankle: Float[np.ndarray, "frames 3"]
    # Rotations of the foot and of its toes from the T-pose
    foot: Float[np.ndarray, "frames 3 3"]
    toes: Float[np.ndarray, "frames 3 3"]
    stands: Bool[np.ndarray, " frames"]  # Frames in which a part of it is held on the floor


@dataclass(frozen=True, slots=True, eq=False)
class HeldFoot:
    """A foot in its contacts: where it stands, and how it is turned."""

    held: Float[np.ndarray, "frames 3"]  # Place of the ankle where the foot stands, NaN where it is free
    foot: Float[np.ndarray, "frames 3 3"]  # Rotation of the foot from the T-pose
    on_toes: Bool[np.ndarray, " frames"]  # Frames in which its toes stand
    measures: FootMeasures
    floor: ScaledFloor | None
    frame_rate_hz: float

    @property
    def stands(self) -> Bool[np.ndarray, " frames"]:
        """Frames in which a part of it is held on the floor."""
        return np.isfinite(self.held[:, 0])

    def path(self, free: Float[np.ndarray, "frames 3"]) -> FootPath:
        """Path of the foot, above the floor; ``free`` are the places of its ankle where it does not stand."""
        stands = self.stands
        if self.floor is None:
            return FootPath(free, self.foot, self.foot, stands)
        moved = np.where(stands[:, None], self.held - free, 0.0)
        eased(moved, _runs(stands), self.frame_rate_hz)
        ankle = free + moved
        lifted = _above_floor(ankle, self.foot, self.measures, self.floor)
        foot = np.where(stands[:, None, None], self.foot, lifted)
        soles = (ankle + times(foot, point) for point in (self.measures.heel, self.measures.ball))
        lowest = np.min([self.floor.height(sole) for sole in soles], axis=0)
        ankle[:, 2] += np.where(stands, 0.0, np.maximum(-lowest, 0.0))
        # Toes stay on the floor while the heel is lifted.
        flat, is_upright = level(self.foot, self.floor)
        share = np.zeros((len(ankle), 1))
        share[self.on_toes & is_upright] = 1.0
        eased(share, _runs(self.on_toes & is_upright), self.frame_rate_hz)
        toes = between(foot, np.where(is_upright[:, None, None], flat, foot), np.minimum(share[:, 0], 1.0))
        return FootPath(ankle, foot, toes, stands)


def hold_foot(
    ankle: Float[np.ndarray, "frames 3"],
    foot: Float[np.ndarray, "frames 3 3"],
    measures: FootMeasures,
    contacts: Sequence[FootContact],
    floor: ScaledFloor | None,
    frame_rate_hz: float,
) -> HeldFoot:
    """Hold a foot so that it stands still in its contacts.

    ``ankle``, ``foot``: path of the ankle, and rotation of the foot from the T-pose, as the person's foot moves.
    ``contacts``: contacts of this foot, those that are held.
    """
    held, on_toes = np.full_like(ankle, np.nan), _rows(contacts, ("toe",), len(ankle))
    if floor is None:
        return HeldFoot(held, foot, on_toes, measures, floor, frame_rate_hz)
    foot = _levelled(ankle, foot, measures, contacts, floor, frame_rate_hz)
    offsets = {"heel": measures.heel, "toe": measures.ball, "foot": np.zeros(3)}
    _, is_upright = level(foot, floor)
    for contact in contacts:
        rows = contact.rows
        offset = times(foot[rows], offsets[contact.part])
        is_held = np.isfinite(held[rows, 0])
        points = ankle[rows] + offset
        place = (held[rows] + offset)[is_held].mean(0) if is_held.any() else np.median(points, axis=0)
        height = 0.0
        if contact.part == "foot":
            # The ankle of a foot on its instep is where it is.
            lies = not is_upright[rows].mean() > _MAX_TILT
            height = max(float(np.median(floor.height(points))), 0.0) if lies else measures.ankle_height
        place[2] += height - floor.height(place)
        held[rows] = np.where(is_held[:, None], held[rows], place - offset)
    return HeldFoot(held, foot, on_toes, measures, floor, frame_rate_hz)


def level(
    foot: Float[np.ndarray, "frames 3 3"], floor: ScaledFloor
) -> tuple[Float[np.ndarray, "frames 3 3"], Bool[np.ndarray, " frames"]]:
    """Rotations of a flat sole in the direction of a foot, and frames of feet tilted less than 60 degrees."""
    up = floor.up
    back = times(foot, _BACKWARD)
    back = back - (back @ up)[:, None] * up
    length = np.linalg.norm(back, axis=-1, keepdims=True)
    is_upright = (foot[:, :, 2] @ up > _MAX_TILT) & (length[:, 0] > _MAX_TILT)
    y = np.where(is_upright[:, None], back / np.maximum(length, 1e-9), _BACKWARD)
    z = np.broadcast_to(up, y.shape)
    x = np.cross(y, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1), is_upright


def _levelled(
    ankle: Float[np.ndarray, "frames 3"],
    foot: Float[np.ndarray, "frames 3 3"],
    measures: FootMeasures,
    contacts: Sequence[FootContact],
    floor: ScaledFloor,
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames 3 3"]:
    """Rotations of a foot whose sole is flat while all of it stands, and not below the floor while a part does."""
    num_frames = len(foot)
    on_heel, on_toes = (_rows(contacts, (part,), num_frames) for part in ("heel", "toe"))
    flat, is_upright = level(foot, floor)
    is_flat = (_rows(contacts, ("foot",), num_frames) | (on_heel & on_toes)) & is_upright
    turns, still = np.zeros((num_frames, 3)), np.array(flat)
    soles = Rotation.from_matrix(flat, assume_valid=True)
    for rows in _runs(is_flat):
        still[rows] = soles[rows].mean().as_matrix()
    levelling = still[is_flat] @ foot[is_flat].swapaxes(1, 2)
    turns[is_flat] = Rotation.from_matrix(levelling, assume_valid=True).as_rotvec()
    eased(turns, _runs(is_flat), frame_rate_hz)
    foot = Rotation.from_rotvec(turns).as_matrix() @ foot
    # On its heel alone a foot does not point into the floor.
    sole = times(foot, measures.ball - measures.heel)
    below = sole @ floor.up
    length = max(float(np.linalg.norm(measures.ball - measures.heel)), 1e-9)
    is_wrong = is_upright & on_heel & ~on_toes & (below < 0.0)
    across = np.cross(sole, floor.up)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    tilts = np.where(is_wrong[:, None], -across * np.arcsin(np.clip(below / length, -1.0, 1.0))[:, None], 0.0)
    # On its toes alone it lifts the heel as far as the ankle is lifted, so that the leg keeps its direction: a person
    # may stand on the tips of the toes, the character stands on its ball.
    turn = _Pitch(foot, measures.ball, floor)
    lifted = turn.at_depth(np.maximum(floor.height(ankle), measures.ankle_height) * floor.up[2])
    is_lifted = is_upright & on_toes & ~on_heel & (turn.pitch > -np.pi / 2)
    # It does not do so at once.
    since = distance_transform_edt(~is_flat) if is_flat.any() else np.full(num_frames, np.inf)
    share = np.clip(since / (_LIFTS_S * frame_rate_hz), 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    tilts = np.where(is_lifted[:, None], turn.vector(share * (lifted - turn.pitch)), tilts)
    eased(tilts, _runs(is_upright & (on_heel | on_toes)), frame_rate_hz)
    return Rotation.from_rotvec(tilts).as_matrix() @ foot


def _above_floor(
    ankle: Float[np.ndarray, "frames 3"],
    foot: Float[np.ndarray, "frames 3 3"],
    measures: FootMeasures,
    floor: ScaledFloor,
) -> Float[np.ndarray, "frames 3 3"]:
    """Rotations of a foot in the air whose ball is not below the floor, as far as its ankle is above it.

    The foot turns about its own axis: toes up, or back if it points down steeply, like a kneeling person's. The
    ankle stays, so that the leg keeps its direction.
    """
    turn = _Pitch(foot, measures.ball, floor)
    lowest = turn.at_depth(np.maximum(floor.height(ankle), 0.0) * floor.up[2])
    is_below = (turn.pitch < lowest) & (turn.pitch > -np.pi - lowest)
    steep = np.clip((_STEEP_RAD[0] + turn.pitch) / (_STEEP_RAD[0] - _STEEP_RAD[1]), 0.0, 1.0)
    angle = (1.0 - steep) * (lowest - turn.pitch) + steep * (-np.pi - lowest - turn.pitch)
    return Rotation.from_rotvec(turn.vector(np.where(is_below, angle, 0.0))).as_matrix() @ foot


class _Pitch:
    """Pitch of a point of a foot about the foot's own axis: its angle above the horizontal, ahead of the ankle."""

    def __init__(
        self, foot: Float[np.ndarray, "frames 3 3"], point: Float[np.ndarray, " 3"], floor: ScaledFloor
    ) -> None:
        self._across = foot[:, :, 0]
        up = floor.up - (self._across @ floor.up)[:, None] * self._across
        slope = np.linalg.norm(up, axis=-1)
        up = up / np.maximum(slope, 1e-9)[:, None]
        turned = times(foot, point)
        raised = np.einsum("fi,fi->f", turned, up)
        ahead = np.einsum("fi,fi->f", turned, np.cross(self._across, up))
        self._aside = np.einsum("fi,fi->f", turned, self._across) * (self._across @ floor.up)
        self._radius = np.maximum(np.hypot(raised, ahead) * slope, 1e-9)
        self.pitch: Float[np.ndarray, " frames"] = np.arctan2(raised, ahead)

    def at_depth(self, depth: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
        """Pitch at which the point is below the ankle by a depth, or as nearly as it gets."""
        return np.arcsin(np.clip((-depth - self._aside) / self._radius, -1.0, 1.0))

    def vector(self, angle: Float[np.ndarray, " frames"]) -> Float[np.ndarray, "frames 3"]:
        """Rotation vectors that add an angle to the pitch."""
        return np.asarray(-self._across * angle[:, None])


def _rows(contacts: Sequence[FootContact], parts: Sequence[str], num_frames: int) -> Bool[np.ndarray, " frames"]:
    stands = np.zeros(num_frames, bool)
    for contact in contacts:
        if contact.part in parts:
            stands[contact.rows] = True
    return stands


def _runs(stands: Bool[np.ndarray, " frames"]) -> list[slice]:
    return [slice(start, stop) for start, stop in find_runs(stands)]
