import av
import numpy as np
import pytest

from pipeline.core.errors import ModelError
from pipeline.core.joints import BODY_FEET, COCO_17, COCO_18, WHOLE_BODY, JointSet, finger_joints
from pipeline.core.options.config import Networks, ReconstructionConfig
from pipeline.core.runtime.packages import samples
from pipeline.detection import models
from pipeline.detection.entries import detected_joint_set
from pipeline.detection.profiles.profile_detector import open_detection, open_landmarks
from pipeline.detection.topdown.topdown_detector import TopDown

FULL = Networks("movenet-multipose", near="blazepose-full", hand="mediapipe-hand", refines_body=True)


@pytest.mark.parametrize(
    ("networks", "choice", "joints"),
    [
        (FULL, "body", COCO_17),
        (FULL, "feet", BODY_FEET),
        (FULL, "whole", WHOLE_BODY),
        (Networks("movenet-multipose"), "feet", COCO_17),
        (Networks("openpose-mobilenet-thin"), "whole", COCO_18),
    ],
)
def test_networks_with_crops_give_joints_that_are_asked_for(networks: Networks, choice: str, joints: JointSet) -> None:
    assert choice in {"body", "feet", "whole"}
    assert detected_joint_set(networks, choice) is joints  # type: ignore[arg-type]


def test_detector_of_bodies_reads_no_crops() -> None:
    with pytest.raises(ModelError, match="reads no crops"):
        open_landmarks("movenet-multipose")


@pytest.fixture(scope="module")
def image_rgb() -> np.ndarray:
    with av.open(samples.install().videos["cam01"]) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def needs(networks: Networks) -> None:
    installed = {one.name for one in models.status() if one.installed}
    missing = sorted(set(networks.names) - installed)
    if missing:
        pytest.skip(f"Not installed: {', '.join(missing)}.")


def test_feet_and_fingers_of_people_in_sample(image_rgb: np.ndarray) -> None:
    needs(FULL)
    detector = open_detection(FULL, "whole")
    assert isinstance(detector, TopDown)
    assert detector.hand is not None
    bodies = detector.detect(image_rgb)
    body = open_detection(Networks("movenet-multipose"), "body").detect(image_rgb)
    assert bodies.keypoints_px.shape == (len(body.score), 61, 2)
    walker_px = bodies.keypoints_px[0]
    # Refinement moves joints by pixels, in an image where people are 600 pixels tall.
    moved_px = np.linalg.norm(walker_px[:17] - body.keypoints_px[0], axis=-1)
    assert 0 < np.median(moved_px) < 12
    # The walker's feet are where one sees them in the picture: heels and toes below the ankles.
    for side in ("left", "right"):
        ankle, heel, toe = walker_px[BODY_FEET.indices((f"{side}_ankle", f"{side}_heel", f"{side}_big_toe"))]
        assert 0 < heel[1] - ankle[1] < 70
        assert 0 < np.linalg.norm(toe - heel) < 150
    for number in range(len(body.score)):
        for side in ("left", "right"):
            fingers_px = bodies.keypoints_px[number, WHOLE_BODY.indices(finger_joints(side))]
            assert np.isnan(fingers_px).all() or np.isfinite(fingers_px).all()
    np.testing.assert_array_equal(bodies.score > 0, np.isfinite(bodies.keypoints_px).all(-1))


def test_same_image_gives_same_bytes(image_rgb: np.ndarray) -> None:
    networks = ReconstructionConfig(joints="feet").networks
    needs(networks)
    first, second = (open_detection(networks, "feet").detect(image_rgb) for _ in range(2))
    assert first.keypoints_px.tobytes() == second.keypoints_px.tobytes()
    assert first.score.tobytes() == second.score.tobytes()
    assert not first.keypoints_px.flags.writeable
