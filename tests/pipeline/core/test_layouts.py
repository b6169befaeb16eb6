import pytest

from pipeline.core.layouts import HAND_POINTS, LAYOUTS, KeypointLayout


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_every_joint_is_one_point(layout: KeypointLayout) -> None:
    used = [point for point in layout.points if point is not None]
    assert sorted(used) == sorted(layout.joints.names)
    assert [layout.points[index] for index in layout.indices] == list(layout.joints.names)
    assert int(layout.name.rpartition("-")[2].rstrip("b")) == len(layout.points)


@pytest.mark.parametrize(
    ("name", "index", "joint"),
    [
        ("coco-17", 10, "right_wrist"),
        ("halpe-26", 16, "right_ankle"),
        ("halpe-26", 19, None),
        ("halpe-26", 21, "right_big_toe"),
        ("halpe-26", 24, "left_heel"),
        ("halpe-136", 16, "right_ankle"),
        ("halpe-136", 24, "left_heel"),
        ("halpe-136", 94, None),
        ("halpe-136", 95, "left_thumb_cmc"),
        ("halpe-136", 135, "right_pinky_tip"),
        ("coco-wholebody-133", 17, "left_big_toe"),
        ("coco-wholebody-133", 19, "left_heel"),
        ("coco-wholebody-133", 22, "right_heel"),
        ("coco-wholebody-133", 90, None),
        ("coco-wholebody-133", 91, None),
        ("coco-wholebody-133", 92, "left_thumb_cmc"),
        ("coco-wholebody-133", 99, "left_index_tip"),
        ("coco-wholebody-133", 132, "right_pinky_tip"),
        ("body-25", 8, "mid_hip"),
        ("body-25", 21, "left_heel"),
        ("body-25b", 1, "left_eye"),
        ("body-25b", 16, "right_ankle"),
        ("body-25b", 18, None),
        ("body-25b", 19, "left_big_toe"),
        ("body-25b", 24, "right_heel"),
        ("mediapipe-33", 2, "left_eye"),
        ("mediapipe-33", 5, "right_eye"),
        ("mediapipe-33", 8, "right_ear"),
        ("mediapipe-33", 11, "left_shoulder"),
        ("mediapipe-33", 16, "right_wrist"),
        ("mediapipe-33", 22, None),
        ("mediapipe-33", 23, "left_hip"),
        ("mediapipe-33", 30, "right_heel"),
        ("mediapipe-33", 31, "left_big_toe"),
    ],
)
def test_points_of_published_orders(name: str, index: int, joint: str | None) -> None:
    assert LAYOUTS[name].points[index] == joint


def test_hands_begin_with_wrist_which_is_body_s() -> None:
    assert HAND_POINTS["left"][:2] == (None, "left_thumb_cmc")
    assert {len(points) for points in HAND_POINTS.values()} == {21}
