"""Detection of expected bodies: BlazePose in crops that the bodies place and turn upright.

Other people in a crop are painted out, as far as the body itself is not there: BlazePose would take their limbs.
"""

from collections.abc import Callable
from contextlib import closing

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from pipeline.association.redetection.expect import ExpectedBodies
from pipeline.capture.session import CaptureSession
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17, SIDES, JointSet
from pipeline.core.progress import OnShare, ignore
from pipeline.detection.bodies import ImageBodies, boxes_around, stack_bodies
from pipeline.detection.chunk import camera_images
from pipeline.detection.network import Network
from pipeline.detection.topdown import blazepose
from pipeline.detection.topdown.blazepose import LANDMARK, PoseOutputs, score_of_peak
from pipeline.detection.topdown.fusion import SHARED_JOINTS, SHARED_LANDMARKS, common_marks_px, landmark_offsets_px
from pipeline.detection.topdown.regions import Region, crop
from pipeline.detection.topdown.topdown_detector import FOOT_JOINTS, FOOT_LANDMARKS

# Least probability that a crop shows a body, by the network.
_LEAST_PRESENCE = 0.5
# Least number of joints below the head.
_LEAST_JOINTS = 4
_HEAD = COCO_17.index("left_shoulder")
# Radii of the parts of a body, as lines between two joints, and of the head, in metres.
_RADII_M = (
    *(
        (f"{side}_{first}", f"{side}_{second}", radius_m)
        for side in SIDES
        for first, second, radius_m in (
            ("shoulder", "elbow", 0.06),
            ("elbow", "wrist", 0.05),
            ("hip", "knee", 0.09),
            ("knee", "ankle", 0.07),
            ("shoulder", "hip", 0.12),
        )
    ),
    ("left_shoulder", "right_shoulder", 0.10),
    ("left_hip", "right_hip", 0.12),
    ("left_shoulder", "right_hip", 0.12),
)
_HEAD_RADIUS_M = 0.12
_PARTS = tuple((COCO_17.index(first), COCO_17.index(second), radius_m) for first, second, radius_m in _RADII_M)
# Colour of what is painted out.
_GREY = np.float32(0.43)


def detect_expected(
    session: CaptureSession,
    expected: ExpectedBodies,
    load_network: Callable[[], Network],
    joints: JointSet,
    at_common_marks: bool,
    turn_deg: float = 0.0,
    on_share: OnShare = ignore,
) -> Detections:
    """Detect expected bodies in the frames of a camera. Raises as ``pipeline.video.decode.decode``.

    - ``expected``: see ``redetection.expect``.
    - ``load_network``: loads BlazePose; called if anybody is expected.
    - ``joints``, ``at_common_marks``: see ``topdown.alone.read_body``.
    - ``turn_deg``: counterclockwise turn that brings the camera's images upright.
    - Returns the bodies that were found, with the joints of ``joints``.
    """
    wanted = np.flatnonzero(expected.is_wanted)
    if not len(wanted):
        return stack_bodies(expected.camera, [], len(joints.names))
    network, found = load_network(), list[tuple[int, ImageBodies]]()
    numbers = np.unique(expected.frame[wanted])
    span = range(int(numbers[0]), int(numbers[-1]) + 1)
    with closing(camera_images(session, expected.camera, span, only=set(numbers.tolist()))) as images:
        for frame, image_rgb in images:
            bodies = expected.within(range(frame, frame + 1))
            for row in np.flatnonzero(bodies.is_wanted).tolist():
                points_px = bodies.keypoints_px[row]
                is_known = np.isfinite(points_px).all(-1)
                region = blazepose.body_region(points_px, is_known.astype(float), turn_deg)
                if region is None:
                    continue
                picture = _without_others(crop(image_rgb, region, blazepose.CROP_PX), region, bodies, row)
                body = _read(picture, region, network, joints, at_common_marks)
                if body is not None:
                    found.append((frame, body))
            on_share(float(np.searchsorted(wanted, np.searchsorted(expected.frame, frame + 1)) / len(wanted)))
    return stack_bodies(expected.camera, found, len(joints.names))


def _without_others(
    picture: Float32[np.ndarray, "1 3 crop crop"], region: Region, bodies: ExpectedBodies, row: int
) -> Float32[np.ndarray, "1 3 crop crop"]:
    """Paint the other bodies of a frame out of a crop, where the body itself is not."""
    if len(bodies.frame) == 1:
        return picture
    points_px = region.crop_from_image(bodies.keypoints_px, blazepose.CROP_PX)
    px_per_m = bodies.px_per_m * (blazepose.CROP_PX / region.side_px)
    own = _covered(points_px[row : row + 1], px_per_m[row : row + 1])
    others = np.arange(len(points_px)) != row
    picture[:, :, _covered(points_px[others], px_per_m[others]) & ~own] = _GREY
    return picture


def _covered(
    points_px: Float[np.ndarray, "bodies 17 2"], px_per_m: Float[np.ndarray, " bodies"]
) -> Bool[np.ndarray, "crop crop"]:
    """Pixels of a crop that bodies cover, as far as their joints are known."""
    painted = np.zeros((blazepose.CROP_PX, blazepose.CROP_PX), np.uint8)
    limit_px = 8 * blazepose.CROP_PX
    for body_px, scale in zip(np.clip(points_px, -limit_px, limit_px), px_per_m, strict=True):
        for first, second, radius_m in _PARTS:
            if np.isfinite(body_px[[first, second]]).all():
                start, end = np.rint(body_px[[first, second]]).astype(int).tolist()
                cv2.line(painted, start, end, 1, min(max(1, int(2 * radius_m * scale)), limit_px))
        head_px = body_px[:_HEAD][np.isfinite(body_px[:_HEAD]).all(-1)]
        if len(head_px):
            middle = np.rint(head_px.mean(0)).astype(int).tolist()
            cv2.circle(painted, middle, min(max(1, int(_HEAD_RADIUS_M * scale)), limit_px), 1, cv2.FILLED)
    return np.asarray(painted > 0)


def _read(
    picture: Float32[np.ndarray, "1 3 crop crop"],
    region: Region,
    network: Network,
    joints: JointSet,
    at_common_marks: bool,
) -> ImageBodies | None:
    """Read the body in a crop; ``None`` if it shows none, or too little of it."""
    outputs = network(picture)
    points_px, score = read_body(blazepose.decode_pose(outputs, region), joints, at_common_marks)
    if float(outputs["presence"].reshape(())) < _LEAST_PRESENCE or np.count_nonzero(score[_HEAD:]) < _LEAST_JOINTS:
        return None
    return ImageBodies(points_px[None], score[None], boxes_around(points_px[None]), np.array([score.mean()]))


_SHARED = COCO_17.indices(SHARED_JOINTS)
_OF_BODY = [LANDMARK[name] for name in COCO_17.names]


def read_body(
    pose: PoseOutputs, joints: JointSet, at_common_marks: bool
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Read the joints of a body from sure heatmaps.

    ``joints``: joints that are wanted: ``COCO_17``, alone or first, and feet; others stay unknown. ``at_common_marks``:
    whether joints are at the common marks of BlazePose and MultiPose, see ``fusion``; else at MultiPose's. Returns
    pixels of the image, NaN where a joint is not sure, and scores on MultiPose's scale, 0 there.
    """
    points_px, peak = pose.refined()
    keypoints_px, score = np.full((len(joints.names), 2), np.nan), np.zeros(len(joints.names))
    body_px = points_px[_OF_BODY]
    marks_px = body_px.copy()
    marks_px[_SHARED] -= landmark_offsets_px(body_px)
    if at_common_marks:
        marks_px = common_marks_px(marks_px)
    keypoints_px[_SHARED], score[_SHARED] = marks_px[_SHARED], score_of_peak(peak[list(SHARED_LANDMARKS)])
    if FOOT_JOINTS[0] in joints.names:
        feet = joints.indices(FOOT_JOINTS)
        keypoints_px[feet], score[feet] = points_px[FOOT_LANDMARKS], score_of_peak(peak[FOOT_LANDMARKS])
    keypoints_px[score == 0] = np.nan
    return keypoints_px, score
