"""Detector of bodies in two steps: bodies in the whole image, then landmarks in the crops of bodies and hands."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.joints import BODY_FEET, COCO_17, SIDES, JointSet, finger_joints
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.network import Network
from pipeline.detection.topdown import blazepose, hands
from pipeline.detection.topdown.blazepose import LANDMARK, SURE_PEAK, PoseOutputs, score_of_peak
from pipeline.detection.topdown.fusion import fuse
from pipeline.detection.topdown.regions import Region, crop

_MIN_SCORE = 0.2
_ANKLES, _WRISTS = (COCO_17.indices((f"left_{kind}", f"right_{kind}")) for kind in ("ankle", "wrist"))
FOOT_JOINTS = BODY_FEET.names[len(COCO_17.names) :]
"""Joints of the feet, in the order of ``BODY_FEET``."""
# Largest distance between the ankles of both networks, as a share of the body's size.
_MAX_ANKLE_DISTANCE = 0.06

_LANDMARK_NAMES = {"heel": "heel", "big_toe": "foot_index"}
_SIDE_AND_PART = tuple(name.split("_", 1) for name in FOOT_JOINTS)
FOOT_LANDMARKS = [LANDMARK[f"{side}_{_LANDMARK_NAMES[part]}"] for side, part in _SIDE_AND_PART]
"""BlazePose's landmarks of ``FOOT_JOINTS``."""
_SIDE = [SIDES.index(side) for side, _ in _SIDE_AND_PART]
_ANKLE_LANDMARKS = [LANDMARK[f"{side}_ankle"] for side in SIDES]


@dataclass(frozen=True, slots=True)
class TopDown:
    """Detector that adds landmarks in crops to the bodies of another detector."""

    body: BodyDetector  # Detector of the joints ``COCO_17`` in whole images
    near: Network  # BlazePose, for crops of 256 x 256 pixels
    hand: Network | None  # Hand network for crops of 224 x 224 pixels; ``None`` for joint sets without fingers
    # True if the joints of the body are averaged with BlazePose's, at the common marks of both; see ``fusion``
    refines_body: bool
    joints: JointSet  # Joints to detect: ``COCO_17``, ``BODY_FEET`` or ``WHOLE_BODY``
    turn_deg: float = 0.0  # Counterclockwise turn that brings images upright

    def __post_init__(self) -> None:
        if self.body.joints.names != COCO_17.names:
            raise ValueError("Crops need bodies with the joints of COCO-17.")

    def detect(self, image_rgb: UInt8[np.ndarray, "height width 3"]) -> ImageBodies:
        """Detect the bodies in an image, in pixels of the image; boxes are those around the body's joints."""
        bodies = self.body.detect(image_rgb)
        keypoints_px = np.full((len(bodies.score), len(self.joints.names), 2), np.nan)
        score = np.zeros(keypoints_px.shape[:2])
        num_body = len(COCO_17.names)
        keypoints_px[:, :num_body], score[:, :num_body] = bodies.keypoints_px, bodies.score
        poses = self._poses(image_rgb, bodies)
        for number, pose in enumerate(poses):
            if self.refines_body:
                fused = fuse(bodies.keypoints_px[number], bodies.score[number], pose)
                keypoints_px[number, :num_body], score[number, :num_body] = fused
            if pose is None:
                continue
            joints_px = keypoints_px[number, :num_body]
            if FOOT_JOINTS[0] in self.joints.names:
                size_px = blazepose.body_size_px(joints_px, bodies.score[number] >= _MIN_SCORE)
                feet = self.joints.indices(FOOT_JOINTS)
                keypoints_px[number, feet], score[number, feet] = read_feet(pose, joints_px[_ANKLES], size_px)
        for hand in hands.without_doubles(self._hands(image_rgb, poses, keypoints_px[:, _WRISTS])):
            fingers = self.joints.indices(finger_joints(SIDES[hand.side]))
            keypoints_px[hand.body, fingers], score[hand.body, fingers] = hand.points_px[1:], hand.score
        return replace(bodies, keypoints_px=read_only(keypoints_px), score=read_only(score))

    def _poses(
        self, image_rgb: UInt8[np.ndarray, "height width 3"], bodies: ImageBodies
    ) -> list[blazepose.PoseOutputs | None]:
        """BlazePose's outputs for each body; ``None`` for a body without a region."""
        regions = [
            blazepose.body_region(keypoints_px, score, self.turn_deg)
            for keypoints_px, score in zip(bodies.keypoints_px, bodies.score, strict=True)
        ]
        outputs = iter(_run(self.near, image_rgb, [region for region in regions if region], blazepose.CROP_PX))
        return [None if region is None else blazepose.decode_pose(next(outputs), region) for region in regions]

    def _hands(
        self,
        image_rgb: UInt8[np.ndarray, "height width 3"],
        poses: Sequence[blazepose.PoseOutputs | None],
        wrists_px: Float[np.ndarray, "bodies sides 2"],
    ) -> list[hands.Hand]:
        if self.hand is None:
            return []
        landmarks_px = [(body, pose.refined()[0]) for body, pose in enumerate(poses) if pose is not None]
        placed = [
            (body, side, region)
            for body, points_px in landmarks_px
            for side in range(len(SIDES))
            if (region := hands.hand_region(points_px, side)) is not None
        ]
        outputs = _run(self.hand, image_rgb, [region for _, _, region in placed], hands.CROP_PX)
        decoded = (
            hands.decode_hand(of_crop, region, body, side, wrists_px[body, side])
            for (body, side, region), of_crop in zip(placed, outputs, strict=True)
        )
        return [hand for hand in decoded if hand is not None]


def _run(
    network: Network, image_rgb: UInt8[np.ndarray, "height width 3"], regions: Sequence[Region], size_px: int
) -> list[dict[str, np.ndarray]]:
    """Outputs of a network for the crops of regions, which it gets as one batch."""
    if not regions:
        return []
    outputs = network(np.concatenate([crop(image_rgb, region, size_px) for region in regions]))
    return [{name: values[number : number + 1] for name, values in outputs.items()} for number in range(len(regions))]


def read_feet(
    pose: PoseOutputs, ankles_px: Float[np.ndarray, "sides 2"], size_px: float
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Read heels and big toes.

    A foot whose ankle is not where the body's ankle is may be another person's, and is left out.

    ``ankles_px``: left and right ankle of the body in pixels of the image, NaN where missing. ``size_px``: size of the
    body in pixels of the image; see ``blazepose.body_size_px``. Returns ``FOOT_JOINTS`` in pixels of the image, NaN
    where missing, and their scores, 0 there.
    """
    points_px, peak = pose.refined()
    distance_px = np.linalg.norm(points_px[_ANKLE_LANDMARKS] - ankles_px, axis=-1)
    is_own = (distance_px <= _MAX_ANKLE_DISTANCE * size_px)[_SIDE]
    is_found = is_own & (peak[FOOT_LANDMARKS] >= SURE_PEAK)
    return (
        np.where(is_found[:, None], points_px[FOOT_LANDMARKS], np.nan),
        np.where(is_found, score_of_peak(peak[FOOT_LANDMARKS]), 0.0),
    )
