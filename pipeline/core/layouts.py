"""Layouts of keypoints: the points of well-known formats and networks in their order, as joints of ours.

Orders: COCO (https://cocodataset.org/#keypoints-2020), COCO-WholeBody
(https://github.com/jin-s13/COCO-WholeBody), Halpe (https://github.com/Fang-Haoshu/Halpe-FullBody), OpenPose
(https://cmu-perceptual-computing-lab.github.io/openpose/web/html/doc/md_doc_02_output.html, and for BODY_25B
https://github.com/CMU-Perceptual-Computing-Lab/openpose_train/blob/master/experimental_models/README.md), BlazePose
(https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker), Human3.6M
(https://github.com/facebookresearch/VideoPose3D, common/h36m_dataset.py), trt_pose
(https://github.com/NVIDIA-AI-IOT/trt_pose, tasks/human_pose/human_pose.json).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.core.joints import BODY_25, BODY_FEET, COCO_17, COCO_18, WHOLE_BODY, JointSet, finger_joints

Points = tuple[str | None, ...]
"""Names of our joints in the order of a layout; ``None`` for a point that is not used."""


@dataclass(frozen=True, slots=True)
class KeypointLayout:
    """Layout of keypoints."""

    name: str  # Name of the layout, with its number of points
    points: Points  # Joint of each point; ``None`` for a point that is not used
    joints: JointSet  # Joint set of the points that are used
    own: tuple[tuple[int, str], ...] = ()  # Places and names of points that are no joints of ours

    @property
    def has_people(self) -> bool:
        """True if any point is a joint of ours; else the points are an animal's."""
        return any(point is not None for point in self.points)

    @property
    def indices(self) -> list[int]:
        """Point of each joint of ``joints``, as an index for the layout's arrays."""
        return [self.points.index(name) for name in self.joints.names]


def _both(*parts: str | None) -> Points:
    """Points of parts of which the left one stands before the right one."""
    return tuple(None if part is None else f"{side}_{part}" for part in parts for side in ("left", "right"))


# The wrist comes first; the body's wrist is used in its place.
_LEFT_HAND: Points = (None, *finger_joints("left"))
_RIGHT_HAND: Points = (None, *finger_joints("right"))
HAND_POINTS: Mapping[str, Points] = {"left": _LEFT_HAND, "right": _RIGHT_HAND}
"""Points of a hand by side: 21, as OpenPose, COCO-WholeBody and MediaPipe order them."""

_COCO_FEET: Points = tuple(
    joint for side in ("left", "right") for joint in (f"{side}_big_toe", None, f"{side}_heel")
)  # the middle one is the small toe
_FACE_POINTS: Points = (None,) * 68
# After COCO's: top of the head, neck, centre of the hips.
_HALPE_BODY: Points = (*COCO_17.names, None, None, None, *_both("big_toe", None, "heel"))

LAYOUTS: Mapping[str, KeypointLayout] = {
    layout.name: layout
    for layout in (
        KeypointLayout("coco-17", COCO_17.names, COCO_17),
        KeypointLayout("coco-wholebody-23", (*COCO_17.names, *_COCO_FEET), BODY_FEET),
        KeypointLayout(
            "coco-wholebody-133",
            (*COCO_17.names, *_COCO_FEET, *_FACE_POINTS, *_LEFT_HAND, *_RIGHT_HAND),
            WHOLE_BODY,
        ),
        KeypointLayout("halpe-26", _HALPE_BODY, BODY_FEET),
        KeypointLayout("halpe-136", (*_HALPE_BODY, *_FACE_POINTS, *_LEFT_HAND, *_RIGHT_HAND), WHOLE_BODY),
        KeypointLayout("body-25", BODY_25.names, BODY_25),
        KeypointLayout("coco-18", COCO_18.names, COCO_18),
        KeypointLayout("trt-pose-18", (*COCO_17.names, "neck"), COCO_18),
        # Another order of as many points as BODY_25 has: neck and top of the head behind COCO's points.
        KeypointLayout("body-25b", (*COCO_17.names, None, None, *_COCO_FEET), BODY_FEET),
        KeypointLayout(
            "mediapipe-33",
            (
                "nose",
                *(None, "left_eye", None),  # inner corner, eye, outer corner
                *(None, "right_eye", None),
                *_both("ear"),
                *(None, None),  # corners of the mouth
                *_both("shoulder", "elbow", "wrist"),
                *_both(None, None, None),  # pinky, index and thumb of the pose, less exact than the hands'
                *_both("hip", "knee", "ankle", "heel", "big_toe"),
            ),
            BODY_FEET,
        ),
    )
}
"""Layouts by name that have a point for each of their joints."""

_LEG: Points = ("hip", "knee", "ankle")
_ARM: Points = ("shoulder", "elbow", "wrist")
FILE_LAYOUTS: Mapping[str, KeypointLayout] = {
    **LAYOUTS,
    "human36m-17": KeypointLayout(
        "human36m-17",
        (
            None,  # pelvis
            *(f"{side}_{part}" for side in ("right", "left") for part in _LEG),
            *(None, None, None, None),  # spine, thorax, neck or nose, top of the head
            *(f"{side}_{part}" for side in ("left", "right") for part in _ARM),
        ),
        COCO_17,
    ),
}
"""Layouts by name that files may have; joints without a point are not detected."""
