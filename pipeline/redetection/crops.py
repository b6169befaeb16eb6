"""Detection of expected bodies: BlazePose in crops that the bodies place and turn upright."""

from contextlib import closing

import numpy as np
from jaxtyping import Float

from pipeline.capture.session import CaptureSession
from pipeline.data.detections import Detections
from pipeline.detect.bodies import ImageBodies, boxes_around
from pipeline.detect.chunk import camera_images, stack_bodies
from pipeline.detect.session import Network
from pipeline.detect.topdown import blazepose
from pipeline.detect.topdown.alone import read_body
from pipeline.detect.topdown.regions import crop
from pipeline.joints import COCO_17, JointSet
from pipeline.progress import OnShare, ignore

# Least probability that a crop shows a body, by the network.
_LEAST_PRESENCE = 0.5
# Least number of joints below the head.
_LEAST_JOINTS = 4
_HEAD = COCO_17.index("left_shoulder")


def detect_expected(
    session: CaptureSession,
    expected: Detections,
    network: Network,
    joints: JointSet,
    at_common_marks: bool,
    turn_deg: float = 0.0,
    on_share: OnShare = ignore,
) -> Detections:
    """Detect expected bodies in the frames of a camera. Raises as ``pipeline.video.decode.decode``.

    Parameters
    ----------
    expected
        Expected joints ``COCO_17``; see ``redetection.expect``.
    network
        BlazePose.
    joints, at_common_marks
        See ``topdown.alone.read_body``.
    turn_deg
        Counterclockwise turn that brings the camera's images upright.

    Returns
    -------
        The bodies that were found, with the joints of ``joints``.
    """
    found: list[tuple[int, ImageBodies]] = []
    numbers = np.unique(expected.frame)
    if len(numbers):
        span = range(int(numbers[0]), int(numbers[-1]) + 1)
        with closing(camera_images(session, expected.camera, span, only=set(numbers.tolist()))) as images:
            for frame, image_rgb in images:
                for row in range(*np.searchsorted(expected.frame, [frame, frame + 1]).tolist()):
                    region = blazepose.body_region(expected.keypoints_px[row], expected.score[row], turn_deg)
                    if region is not None:
                        outputs = network(crop(image_rgb, region, blazepose.CROP_PX))
                        points_px, score = read_body(blazepose.decode_pose(outputs, region), joints, at_common_marks)
                        is_present = float(outputs["presence"].reshape(())) >= _LEAST_PRESENCE
                        if is_present and np.count_nonzero(score[_HEAD:]) >= _LEAST_JOINTS:
                            found.append((frame, _one_body(points_px, score)))
                    on_share((row + 1) / len(expected.frame))
    return stack_bodies(expected.camera, found, len(joints.names))


def _one_body(points_px: Float[np.ndarray, "joints 2"], score: Float[np.ndarray, " joints"]) -> ImageBodies:
    return ImageBodies(points_px[None], score[None], boxes_around(points_px[None]), np.array([score.mean()]))
