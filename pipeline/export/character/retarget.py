"""Retargeting: the motion of a person's skeleton on the bones of a character.

Each bone turns from its T-pose as the joint of the skeleton does, so that limbs have the person's directions. Paths are
scaled by the length of the legs. Losses of directions alone are fitted in each frame: feet stand where they stand
(``limbs``), hips shift and tilt for them, legs reach them, and hands meet where they met. A hand that is near
the other one, or near the floor, is led to the scaled place; the weight rises from 0 to 1 between two distances, which
are shares of the arm's length.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.joints import FINGERS
from pipeline.export.character import limbs
from pipeline.export.character.bone_names import HEAD, HIPS, SIDES
from pipeline.export.character.figure import CharacterFigure
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M
from pipeline.motion.skeleton.feet.support import belt_m
from pipeline.motion.skeleton.fitting.articulation import ARM_HINGES, KNEE_HINGE
from pipeline.motion.skeleton.model import INDEX, posed_joints
from pipeline.motion.skeleton.rotations import times

# Time over which hips follow a leg that is bent at a right angle; straighter legs are followed sooner.
_HIPS_SMOOTH_S = 0.15
# Least tangent of half a bend: a few millimetres bend straighter legs as much as this one.
_STRAIGHT = 0.05
# Weights of the hips' tilt and of their shift, as a share of the leg's length, beside 1 for the direction of a leg.
_TILT, _SHIFT = 1.0, 0.05


class StandingLeg(NamedTuple):
    """Leg of a character as it would be if the hips were the person's, in the world."""

    hip: Float[np.ndarray, "frames 3"]  # Place of its joint at the hips
    middle: Float[np.ndarray, "frames 3"]  # Place of the middle of the hips
    # Ways from the hip to the knee and from there to the ankle that have the person's directions
    thigh: Float[np.ndarray, "frames 3"]
    shin: Float[np.ndarray, "frames 3"]
    ankle: Float[np.ndarray, "frames 3"]  # Place of the ankle where the foot stands, NaN where it is free


def shift_and_tilt(
    legs: Sequence[StandingLeg], carries: Float[np.ndarray, " frames"], frame_rate_hz: float
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames 3"]]:
    """Shift of the hips, and rotation vector (radians) of their tilt about their middle, in each frame.

    ``carries``: number of hands that stand on the floor: arms turn for hips that shift.
    """
    num_frames = len(carries)
    size = float(np.mean([np.linalg.norm(leg.thigh[0]) + np.linalg.norm(leg.shin[0]) for leg in legs]))
    normal = np.zeros((num_frames, 6, 6))
    normal[:, range(3), range(3)] = _SHIFT + carries[:, None]
    normal[:, range(3, 6), range(3, 6)] = _TILT
    right = np.zeros((num_frames, 6))
    for leg in legs:
        stands = np.isfinite(leg.ankle[:, 0])
        hip, thigh, shin = leg.hip[stands], leg.thigh[stands], leg.shin[stands]
        wanted = leg.ankle[stands] - thigh - shin - hip
        weights = _stiffness(thigh, shin)
        # A joint moves by shift + tilt x its way from the middle.
        moves = np.zeros((len(hip), 3, 6))
        moves[:, range(3), range(3)] = 1.0
        moves[:, :, 3:] = _crossed((leg.middle[stands] - hip) / size)
        weighted = moves.swapaxes(1, 2) @ weights
        normal[stands] += weighted @ moves
        right[stands] += (weighted @ (wanted / size)[..., None])[..., 0]
    found = _smoothest(normal, right, (_HIPS_SMOOTH_S * frame_rate_hz) ** 4)
    return found[:, :3] * size, found[:, 3:]


def _stiffness(
    thigh: Float[np.ndarray, "frames 3"], shin: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 3 3"]:
    """Quadratic forms of the squared angle of a leg's bones for a way of its end, in lengths of the leg."""
    first, second = (bone / np.linalg.norm(bone, axis=-1, keepdims=True) for bone in (thigh, shin))
    along, across = first + second, np.linalg.norm(first - second, axis=-1)
    # Cosine and sine of half the bend, both doubled.
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
    along = along / length[:, None]
    stiff = 1.0 / ((across / length) ** 2 + _STRAIGHT**2)
    return np.asarray(np.eye(3) + stiff[:, None, None] * along[:, :, None] * along[:, None, :])


def _crossed(vectors: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3 3"]:
    """Matrices of the cross product of vectors with others."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)


def _smoothest(
    normal: Float[np.ndarray, "frames n n"], right: Float[np.ndarray, "frames n"], stiffness: float
) -> Float[np.ndarray, "frames n"]:
    """Values x with the smallest sum of x' normal x / 2 - right x and of squared second differences."""
    num_frames, size = right.shape
    bands = np.zeros((2 * size + 1, num_frames, size))
    for offset in range(size):
        for column in range(size - offset):
            bands[offset, :, column] = normal[:, column + offset, column]
    if num_frames > 2:
        squares = np.zeros((3, num_frames))
        for first in range(3):
            for second in range(first, 3):
                squares[second - first, first : num_frames - 2 + first] += (1, -2, 1)[first] * (1, -2, 1)[second]
        bands[::size] += stiffness * squares[:, :, None]
    return np.asarray(solveh_banded(bands.reshape(2 * size + 1, -1), right.reshape(-1), lower=True)).reshape(
        right.shape
    )


NEAR_HAND, FAR_HAND = 0.35, 0.8
"""Distance of both wrists, in lengths of the arm, up to which they keep it, and from which they are free."""
NEAR_FLOOR, FAR_FLOOR = 0.2, 0.5
"""Height of a wrist above the floor, likewise, up to which it is at its scaled place."""

_DOWN, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
_OUTWARDS: Mapping[str, Float[np.ndarray, " 3"]] = {"Left": np.array([1.0, 0, 0]), "Right": np.array([-1.0, 0, 0])}
# Time over which hips are lowered for legs that are too short, before and after.
_LOWER_S, _SMOOTH_S = 0.12, 0.04


@dataclass(frozen=True, slots=True, eq=False)
class CharacterMotion:
    """Motion of a character, in the skeleton's axes and the character's unit; nodes without a rotation stay at rest."""

    figure: CharacterFigure
    source: SkeletonMotion  # Motion of the person
    scale: float  # Length of a metre of the person's world in the character's unit
    hips: Float[np.ndarray, "frames 3"]  # Places of the bone of the hips
    # Rotations of nodes from the rest pose, about the world's axes
    turns: Mapping[int, Float[np.ndarray, "frames 3 3"]]
    stands: Mapping[str, Bool[np.ndarray, " frames"]]  # Frames in which a foot is held, by side
    floor: limbs.ScaledFloor | None
    ground: Float[np.ndarray, "frames 3"]  # Way of the ground, such as a treadmill's belt, since the first frame


def retarget(source: SkeletonMotion, figure: CharacterFigure, floor: Floor | None) -> CharacterMotion:
    """Move a character as a person.

    ``source``: motion of the person; its contacts that are pinned are held. ``floor``: floor of the take; ``None``:
    there is none.
    """
    fit = _Fit(source, figure, floor)
    fit.stand()
    fit.move_trunk()
    fit.move_arms()
    fit.move_fingers()
    return CharacterMotion(
        figure,
        source,
        fit.scale,
        read_only(fit.hips),
        {node: read_only(turns) for node, turns in fit.turns.items()},
        fit.stands,
        fit.floor,
        read_only(fit.ground),
    )


class _Fit:
    """Fit of a character to a person's motion, step by step from the feet up."""

    def __init__(self, source: SkeletonMotion, figure: CharacterFigure, floor: Floor | None) -> None:
        self._source, self._figure, self._joints = source, figure, figure.joints
        self._places_m, self._turned = posed_joints(source)
        legs_m = [source.bone_length_m[[INDEX[f"{side}Leg"], INDEX[f"{side}Foot"]]].sum() for side in SIDES]
        self.scale = figure.leg_length / float(np.mean(legs_m))
        self.floor = limbs.scaled(floor, self.scale)
        self._lift = self._height_of_soles(floor)
        ankles_m = self._places_m[:, [INDEX[f"{side}Foot"] for side in SIDES]]
        is_known = np.ones(ankles_m.shape[:2], bool)
        self.ground = self.scale * belt_m(ankles_m, is_known, source.root_m, source.frame_rate_hz)
        self._arm_m = float(
            np.mean([source.bone_length_m[[INDEX[f"{s}ForeArm"], INDEX[f"{s}Hand"]]].sum() for s in SIDES])
        )
        self._on_floor = {side: self._share_on_floor(floor, side) for side in SIDES}
        self.stands: dict[str, Bool[np.ndarray, " frames"]] = {}
        self.turns: dict[int, Float[np.ndarray, "frames 3 3"]] = {}
        self.hips = np.zeros((len(source.root_m), 3))

    def joint(self, name: str) -> Float[np.ndarray, "frames 3 3"]:
        """Rotation of a joint of the skeleton from the T-pose."""
        return self._turned[INDEX[name]]

    def place(self, name: str) -> Float[np.ndarray, "frames 3"]:
        """Scaled place of a joint of the skeleton."""
        return self.scale * self._places_m[:, INDEX[name]]

    def set_turn(self, joint: str, turned: Float[np.ndarray, "frames 3 3"]) -> None:
        """Turn the bone of a joint, if the character has it; ``turned`` is from the T-pose."""
        if (node := self._joints.get(joint)) is not None:
            self.turns[node] = times(turned, self._figure.upright[node])

    def _share_on_floor(self, floor: Floor | None, side: str) -> Float[np.ndarray, " frames"]:
        """Weight of the scaled place of a hand: 1 near the floor."""
        if floor is None:
            return np.zeros(len(self._places_m))
        height_m = floor.height_m(self._places_m[:, INDEX[f"{side}Hand"]])
        return _near(height_m / self._arm_m, NEAR_FLOOR, FAR_FLOOR)

    def _height_of_soles(self, floor: Floor | None) -> Float[np.ndarray, " frames"]:
        """Height by which the character's ankles are above the person's scaled ones, as its soles are thicker.

        It fades as the shins lie down: bodies on the floor have no soles below them.
        """
        ankles = [self._places_m[:, INDEX[f"{side}Foot"]] for side in SIDES]
        heights_m: list[float] = []
        for side, ankle_m in zip(SIDES, ankles, strict=True):
            for contact in self._source.contacts:
                if floor is not None and contact.pinned and contact.side == side.lower() and contact.part != "toe":
                    heights_m += floor.height_m(ankle_m[contact.rows]).tolist()
        person_m = float(np.median(heights_m)) if heights_m else ANKLE_HEIGHT_M
        own = np.mean([foot.ankle_height for foot in self._figure.feet.values()])
        shins = [_unit(self._places_m[:, INDEX[f"{s}Leg"]] - self._places_m[:, INDEX[f"{s}Foot"]])[:, 2] for s in SIDES]
        upright = np.clip(np.mean(shins, axis=0), 0.0, 1.0)
        smooth = gaussian_filter1d(upright, max(_LOWER_S * self._source.frame_rate_hz, 1e-3), mode="nearest")
        return np.asarray((own - self.scale * person_m) * smooth)

    def stand(self) -> None:
        """Place feet and hips, and legs between them."""
        figure, joints = self._figure, self._joints
        held = {side: self._held_foot(side) for side in SIDES}
        middle, hips = self.place(HIPS) + self._lift[:, None] * _UP, self.joint(HIPS)
        at_rest = {side: figure.positions[joints[f"{side}UpLeg"]] for side in SIDES}
        rest = sum(at_rest.values(), np.zeros(3)) / len(SIDES)
        lengths = {
            side: (figure.length(f"{side}UpLeg", f"{side}Leg"), figure.length(f"{side}Leg", f"{side}Foot"))
            for side in SIDES
        }
        legs = {
            side: StandingLeg(
                hip=middle + times(hips, at_rest[side] - rest),
                middle=middle,
                thigh=lengths[side][0] * times(self.joint(f"{side}UpLeg"), _DOWN),
                shin=lengths[side][1] * times(self.joint(f"{side}Leg"), _DOWN),
                ankle=held[side].held + self.ground,
            )
            for side in SIDES
        }
        carries = sum(self._on_floor.values(), np.zeros(len(middle)))
        shift, tilt = shift_and_tilt(tuple(legs.values()), carries, self._source.frame_rate_hz)
        middle, hips = middle + shift, Rotation.from_rotvec(tilt).as_matrix() @ hips
        starts = {side: middle + times(hips, at_rest[side] - rest) for side in SIDES}
        lowered = self._lowered(held, starts, lengths)
        self.set_turn(HIPS, hips)
        self.hips = middle - lowered + times(hips, figure.positions[joints[HIPS]] - rest)
        for side in SIDES:
            start, leg = starts[side] - lowered, legs[side]
            path = held[side].path(start + leg.thigh + leg.shin - self.ground)
            path = path._replace(ankle=path.ankle + self.ground)
            limb = limbs.BentLimb(self.joint(f"{side}UpLeg"), self.joint(f"{side}Leg"), path.ankle)
            limb = limbs.reach(start, limb, _DOWN, np.array(KNEE_HINGE), lengths[side], path.ankle, is_firm=True)
            for joint, turned in zip(
                ("UpLeg", "Leg", "Foot", "ToeBase"), (limb.upper, limb.lower, path.foot, path.toes), strict=True
            ):
                self.set_turn(f"{side}{joint}", turned)
            self.stands[side] = path.stands

    def _held_foot(self, side: str) -> limbs.HeldFoot:
        """Foot in its contacts, on the ground that a treadmill may move."""
        ankle = self.place(f"{side}Foot") + self._lift[:, None] * _UP - self.ground
        contacts = [c for c in self._source.contacts if c.pinned and c.side == side.lower()]
        foot, measures = self.joint(f"{side}Foot"), self._figure.feet[side]
        return limbs.hold_foot(ankle, foot, measures, contacts, self.floor, self._source.frame_rate_hz)

    def _lowered(
        self,
        held: Mapping[str, limbs.HeldFoot],
        starts: Mapping[str, Float[np.ndarray, "frames 3"]],
        lengths: Mapping[str, tuple[float, float]],
    ) -> Float[np.ndarray, "frames 3"]:
        """Way down of the hips for feet that stand out of reach all the same."""
        lowered = np.zeros(len(self.hips))
        for side in SIDES:
            # NaN where the foot is free.
            way = starts[side] - held[side].held - self.ground
            longest = sum(lengths[side]) * limbs.REACH
            reachable = np.sqrt(np.maximum(longest**2 - way[:, 0] ** 2 - way[:, 1] ** 2, 0.0))
            lowered = np.fmax(lowered, way[:, 2] - reachable)
        return _smoothed_above(lowered, self._source.frame_rate_hz)[:, None] * _UP

    def move_trunk(self) -> None:
        """Bend spine and neck evenly between the joints of the skeleton, and turn collar bones and head."""
        names, mapping = self._figure.rig.names, self._figure.mapping
        spine, neck = ([names.index(bone) for bone in bones] for bones in (mapping.spine, mapping.neck))
        for number, node in enumerate(spine, 1):
            share = (number - 1) / (len(spine) - 1) if len(spine) > 1 else 1.0
            self.turns[node] = limbs.between(self.joint("Spine"), self.joint("Chest"), share)
        for number, node in enumerate(neck):
            self.turns[node] = limbs.between(self.joint("Neck"), self.joint(HEAD), number / len(neck))
        for joint in (HEAD, *(f"{side}Shoulder" for side in SIDES)):
            self.set_turn(joint, self.joint(joint))

    def move_arms(self) -> None:
        """Turn arms as the person's, and lead hands to where they met."""
        figure = self._figure
        arms: dict[str, limbs.BentLimb] = {}
        starts, lengths, free, led = {}, {}, {}, {}
        for side in SIDES:
            lengths[side] = (
                figure.length(f"{side}Arm", f"{side}ForeArm"),
                figure.length(f"{side}ForeArm", f"{side}Hand"),
            )
            starts[side] = node_place(figure, self.hips, self.turns, self._joints[f"{side}Arm"])
            upper, lower = self.joint(f"{side}Arm"), self.joint(f"{side}ForeArm")
            (first, second), out = lengths[side], _OUTWARDS[side]
            free[side] = starts[side] + first * times(upper, out) + second * times(lower, out)
            arms[side] = limbs.BentLimb(upper, lower, free[side])
        wrists_m = {side: self._places_m[:, INDEX[f"{side}Hand"]] for side in SIDES}
        for side in SIDES:
            share = self._on_floor[side]
            led[side] = free[side] + share[:, None] * (self.scale * wrists_m[side] - free[side])
        apart_m = wrists_m["Left"] - wrists_m["Right"]
        share = _near(np.linalg.norm(apart_m, axis=-1) / self._arm_m, NEAR_HAND, FAR_HAND)[:, None]
        middle = (led["Left"] + led["Right"]) / 2
        for side, sign in zip(SIDES, (0.5, -0.5), strict=True):
            place = led[side] + share * (middle + sign * self.scale * apart_m - led[side])
            limb = limbs.reach(
                starts[side],
                arms[side],
                _OUTWARDS[side],
                np.array(ARM_HINGES[side]),
                lengths[side],
                place,
                is_firm=False,
            )
            self.set_turn(f"{side}Arm", limb.upper)
            self.set_turn(f"{side}ForeArm", limb.lower)
            self.set_turn(f"{side}Hand", self.joint(f"{side}Hand"))
        self._share_twists()

    def _share_twists(self) -> None:
        """Give bones along a forearm their share of the hand's twist."""
        figure = self._figure
        for bone, joint in figure.mapping.twists.items():
            node, elbow = figure.rig.names.index(bone), self._joints[joint.replace("Hand", "ForeArm")]
            hand = self._joints[joint]
            along = figure.positions[hand] - figure.positions[elbow]
            share = np.clip((figure.positions[node] - figure.positions[elbow]) @ along / (along @ along), 0.0, 1.0)
            axis = along / np.linalg.norm(along)
            angle = limbs.twist_rad(self.turns[elbow].swapaxes(1, 2) @ self.turns[hand], axis)
            turned = Rotation.from_rotvec(share * angle[:, None] * axis).as_matrix()
            self.turns[node] = self.turns[elbow] @ turned

    def move_fingers(self) -> None:
        """Turn fingers as the person's, if they are known."""
        for side in SIDES:
            for finger in FINGERS:
                for number in (1, 2, 3):
                    joint = f"{side}Hand{finger.capitalize()}{number}"
                    if INDEX[joint] < len(self._turned):
                        self.set_turn(joint, self.joint(joint))


def node_place(
    figure: CharacterFigure,
    hips: Float[np.ndarray, "frames 3"],
    turns: Mapping[int, Float[np.ndarray, "frames 3 3"]],
    node: int,
) -> Float[np.ndarray, "frames 3"]:
    """Places of a node below the hips."""
    top = figure.joints[HIPS]
    place, turned = hips, turns[top]
    for above, below in zip((way := figure.rig.path(top, node)), way[1:], strict=False):
        turned = turns.get(above, turned)
        place = place + times(turned, figure.positions[below] - figure.positions[above])
    return place


def _near(distance: Float[np.ndarray, " frames"], near: float, far: float) -> Float[np.ndarray, " frames"]:
    """Weight 1 up to a distance, 0 from another one on, and a smooth step between."""
    share = np.clip((far - distance) / (far - near), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _smoothed_above(values: Float[np.ndarray, " frames"], frame_rate_hz: float) -> Float[np.ndarray, " frames"]:
    """Smooth curve that is nowhere below some values, which are mostly 0."""
    if not values.any():
        return values
    sigma = max(_SMOOTH_S * frame_rate_hz, 0.5)
    # The widest of both: the maximum reaches as far as the filter does.
    truncate = max(_LOWER_S / _SMOOTH_S, 1.0)
    radius = int(truncate * sigma + 0.5)
    highest = maximum_filter1d(values, 2 * radius + 1, mode="nearest")
    return np.asarray(gaussian_filter1d(highest, sigma, truncate=truncate, mode="nearest"))


def _unit(vectors: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))
