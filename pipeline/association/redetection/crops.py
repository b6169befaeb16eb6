"""Detection of expected bodies: BlazePose in crops that the bodies place and turn upright."""

from collections.abc import Callable
from contextlib import closing

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.capture.session import CaptureSession
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17, JointSet
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


def detect_expected(
    session: CaptureSession,
    expected: Detections,
    load_network: Callable[[], Network],
    joints: JointSet,
    at_common_marks: bool,
    turn_deg: float = 0.0,
    on_share: OnShare = ignore,
) -> Detections:
    """Detect expected bodies in the frames of a camera. Raises as ``pipeline.video.decode.decode``.

    - ``expected``: expected joints ``COCO_17``; see ``redetection.expect``.
    - ``load_network``: loads BlazePose; called if anybody is expected.
    - ``joints``, ``at_common_marks``: see ``topdown.alone.read_body``.
    - ``turn_deg``: counterclockwise turn that brings the camera's images upright.
    - Returns the bodies that were found, with the joints of ``joints``.
    """
    if not len(expected.frame):
        return stack_bodies(expected.camera, [], len(joints.names))
    network, found = load_network(), list[tuple[int, ImageBodies]]()
    numbers = np.unique(expected.frame)
    span = range(int(numbers[0]), int(numbers[-1]) + 1)
    with closing(camera_images(session, expected.camera, span, only=set(numbers.tolist()))) as images:
        for frame, image_rgb in images:
            for row in range(*np.searchsorted(expected.frame, [frame, frame + 1]).tolist()):
                region = blazepose.body_region(expected.keypoints_px[row], expected.score[row], turn_deg)
                body = None if region is None else _read(image_rgb, region, network, joints, at_common_marks)
                if body is not None:
                    found.append((frame, body))
                on_share((row + 1) / len(expected.frame))
    return stack_bodies(expected.camera, found, len(joints.names))


def _read(
    image_rgb: UInt8[np.ndarray, "height width 3"],
    region: Region,
    network: Network,
    joints: JointSet,
    at_common_marks: bool,
) -> ImageBodies | None:
    """Read the body in a region; ``None`` if it shows none, or too little of it."""
    outputs = network(crop(image_rgb, region, blazepose.CROP_PX))
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
