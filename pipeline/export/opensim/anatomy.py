"""Markers of OpenSim's model: names, the bodies that carry them, and the part of a person that each one is.

Names are as in Pose2Sim and OpenCap where they mean the same: ``RHip`` for centres of joints and for what a
detector marks, ``r.ASIS_study`` for landmarks of bones. Bodies, axes and sizes are as in Pose2Sim's model without
muscles: X to the front, Y up, Z to the right in the anatomical position, metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Marker:
    """Marker of the model."""

    body: str  # Body of the model that carries it
    place_m: Place  # Place in this body of the generic model
    weight: float  # Weight in the inverse kinematics


@dataclass(frozen=True, slots=True)
class CentreMarker(Marker):
    """Centre of a joint: a joint of the skeleton."""

    joint: str  # Joint of the skeleton
    landmark: str  # Joint of the detector that must have a position


@dataclass(frozen=True, slots=True)
class BoneMarker(Marker):
    """Landmark of a bone, placed by a segment of the skeleton."""

    segment: str  # Segment of ``pipeline.motion.body_segments``, which must be observed
    joint: str  # Joint of the skeleton from which it is placed
    offset_m: Place  # Place from this joint in the segment's axes, in the generic model's size


@dataclass(frozen=True, slots=True)
class SeenMarker(Marker):
    """Mark that the detector finds, such as the nose."""

    landmark: str  # Joint of the detector
    segment: str  # Segment that moves it


HIPS: Place = (-0.0707, -0.0661, 0.0)
"""Middle of the hips in the pelvis."""
LUMBAR: Place = (-0.1007, 0.0815, 0.0)
"""Joint of pelvis and torso in the pelvis; the torso's origin."""
SHOULDERS: Place = (0.003155, 0.3715, 0.0)
"""Middle of the shoulders in the torso."""
NECK: Place = (0.0, 0.54145811, 0.0)
"""Joint of torso and head in the torso."""
NECK_IN_HEAD: Place = (0.0, 0.03, 0.0)
"""The same joint in the head."""
ANKLE_IN_FOOT: Place = (0.04877, 0.04195, -0.00792)
"""Ankle in the heel bone of the right side."""
HALF_HIPS_M, HALF_SHOULDERS_M = 0.0835, 0.17
THIGH_M, SHANK_M, UPPER_ARM_M, FOREARM_M = 0.408, 0.4196, 0.2867, 0.2502
"""Distances of the centres of joints."""
FOOT_M = 0.2738
"""Distance of the markers of heel and big toe."""
STATURE_M = 1.77
"""Stature whose lengths by ``pipeline.motion.skeleton.model`` are the generic model's lengths."""

FEET: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {side: tuple(f"{body}_{side[0]}" for body in ("talus", "calcn", "toes")) for side in ("left", "right")}
)
"""Bodies of a foot by side."""

_KNEE, _ANKLE, _ELBOW = (-0.00809, -0.40796, -0.00275), (0.0, -0.43, 0.0), (0.013144, -0.286273, -0.009595)
# On the line through shoulder and elbow: the angle of the elbow is then 0 in a straight arm, as among our angles. The
# joint of the model's wrist is 4 degrees behind this line.
_WRIST = (0.01147, -0.24982, -0.00837)
# Centres of joints lead; feet and heads, which the model can't turn as people do, follow.
_OF_CENTRES, _OF_PELVIS, _OF_BONES, _OF_FEET, _OF_HEADS = 20.0, 10.0, 5.0, 2.0, 1.0


def _of_side(side: str) -> dict[str, Marker]:
    """Markers of a side; places on the left are those on the right, mirrored."""
    outwards, low = (1.0, "r") if side == "right" else (-1.0, "l")
    prefix, study, title = low.upper(), "r" if side == "right" else "L", side.capitalize()

    def to(place: Place) -> Place:
        return (place[0], place[1], outwards * place[2])

    def centre(joint: str, landmark: str, body: str, place: Place) -> CentreMarker:
        return CentreMarker(body, to(place), _OF_CENTRES, f"{title}{joint}", f"{side}_{landmark}")

    def aside(segment: str, joint: str, body: str, centre: Place, aside_m: float) -> BoneMarker:
        place = (centre[0], centre[1], centre[2] + aside_m)
        offset = (0.0, 0.0, aside_m)
        return BoneMarker(f"{body}_{low}", to(place), _OF_BONES, f"{side}_{segment}", f"{title}{joint}", to(offset))

    def pelvis(place: Place) -> BoneMarker:
        offset = (place[0] - HIPS[0], place[1] - HIPS[1], place[2] - HIPS[2])
        return BoneMarker("pelvis", to(place), _OF_PELVIS, "pelvis", "Hips", to(offset))

    def seen(landmark: str, body: str, place: Place, weight: float, segment: str) -> SeenMarker:
        return SeenMarker(body, to(place), weight, f"{side}_{landmark}", segment)

    def foot_marker(landmark: str, place: Place) -> SeenMarker:
        return seen(landmark, f"calcn_{low}", place, _OF_FEET, f"{side}_foot")

    def hand_marker(landmark: str, place: Place) -> SeenMarker:
        return seen(landmark, f"hand_{low}", place, _OF_BONES, f"{side}_hand")

    return {
        f"{prefix}Hip": centre("UpLeg", "hip", "pelvis", (HIPS[0], HIPS[1], HALF_HIPS_M)),
        f"{prefix}Knee": centre("Leg", "knee", f"femur_{low}", _KNEE),
        f"{prefix}Ankle": centre("Foot", "ankle", f"tibia_{low}", _ANKLE),
        f"{prefix}Shoulder": centre("Arm", "shoulder", "torso", (SHOULDERS[0], SHOULDERS[1], HALF_SHOULDERS_M)),
        f"{prefix}Elbow": centre("ForeArm", "elbow", f"humerus_{low}", _ELBOW),
        f"{prefix}Wrist": centre("Hand", "wrist", f"ulna_{low}", _WRIST),
        f"{study}.ASIS_study": pelvis((0.028, 0.01, 0.128)),
        f"{study}.PSIS_study": pelvis((-0.154, 0.025, 0.05)),
        f"{study}_knee_study": aside("thigh", "Leg", "femur", _KNEE, 0.055),
        f"{study}_mknee_study": aside("thigh", "Leg", "femur", _KNEE, -0.055),
        f"{study}_ankle_study": aside("shank", "Foot", "tibia", _ANKLE, 0.045),
        f"{study}_mankle_study": aside("shank", "Foot", "tibia", _ANKLE, -0.045),
        f"{study}_lelbow_study": aside("upper_arm", "ForeArm", "humerus", _ELBOW, 0.045),
        f"{study}_melbow_study": aside("upper_arm", "ForeArm", "humerus", _ELBOW, -0.045),
        f"{prefix}Heel": foot_marker("heel", (-0.03, 0.02, -0.005)),
        f"{prefix}BigToe": foot_marker("big_toe", (0.2435, 0.008, -0.0135)),
        f"{prefix}SmallToe": foot_marker("small_toe", (0.206, 0.008, 0.03)),
        f"{prefix}Index": hand_marker("index_mcp", (0.0031, -0.0826, 0.016)),
        f"{prefix}Pinky": hand_marker("pinky_mcp", (0.0031, -0.0738, -0.0325)),
        f"{prefix}Eye": seen("eye", "head", (0.084, 0.045, 0.031), _OF_HEADS, "head"),
        f"{prefix}Ear": seen("ear", "head", (0.01, 0.025, 0.072), _OF_HEADS, "head"),
    }


MARKERS: Mapping[str, Marker] = MappingProxyType(
    {
        **_of_side("right"),
        **_of_side("left"),
        "Nose": SeenMarker("head", (0.116, 0.0126, 0.0), _OF_HEADS, "nose", "head"),
    }
)
"""Markers by name."""
