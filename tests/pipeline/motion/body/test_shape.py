import numpy as np
import pytest

from pipeline.motion.body.joints import BODY_INDEX, BODY_JOINTS, TWIST_JOINTS
from pipeline.motion.body.shape import BodyShapes, shape_body
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON
from tests.pipeline.motion.body.conftest import adult_lengths_m


def volume_l(vertices_m: np.ndarray, triangles: np.ndarray) -> float:
    """Volume in litres that a mesh encloses."""
    first, second, third = np.moveaxis(vertices_m[triangles], 1, 0)
    return float(np.einsum("ti,ti->t", first, np.cross(second, third)).sum() / 6.0 * 1000.0)


@pytest.mark.parametrize("num_joints", [len(SKELETON), len(WHOLE_SKELETON)])
@pytest.mark.parametrize("stature_m", [0.8, 1.2, 1.45, 1.75, 2.05])
def test_body_stands_on_floor_as_tall_as_its_skeleton(shapes: BodyShapes, stature_m: float, num_joints: int) -> None:
    body = shape_body(shapes, adult_lengths_m(stature_m, num_joints))
    assert body.vertices_m[:, 2].min() == pytest.approx(0.0, abs=0.002)
    assert body.vertices_m[:, 2].max() == pytest.approx(stature_m, abs=0.01)
    assert len(body.joints_m) == num_joints + len(TWIST_JOINTS)
    assert body.carriers.max() < len(body.joints_m)
    np.testing.assert_allclose(body.weights.sum(1), 1.0)
    # A person of 1.75 m has about 70 litres; bodies of one shape grow with the cube of the stature.
    assert 60.0 < volume_l(body.vertices_m, body.triangles) * (1.75 / stature_m) ** 3 < 95.0


def test_skin_is_where_joints_are(shapes: BodyShapes) -> None:
    """The middle of the skin around each joint of a limb is near the joint, for people of any proportions."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        lengths_m = adult_lengths_m(1.7) * rng.uniform(0.85, 1.15, len(WHOLE_SKELETON))
        body = shape_body(shapes, lengths_m)
        for side in ("Left", "Right"):
            for joint, axis in (("ForeArm", 0), ("Hand", 0), ("Leg", 2), ("Foot", 2)):
                place_m = body.joints_m[INDEX[f"{side}{joint}"]]
                apart_m = np.abs(body.vertices_m - place_m)
                around = (apart_m[:, axis] < 0.015) & (apart_m.max(1) < 0.12)
                low_m, high_m = body.vertices_m[around].min(0), body.vertices_m[around].max(0)
                # Heels are behind ankles.
                limit_m = 0.03 if joint == "Foot" else 0.015
                assert np.abs(0.5 * (low_m + high_m) - place_m).max() < limit_m, (side, joint)


def test_bones_have_person_s_lengths_and_head_its_size(shapes: BodyShapes) -> None:
    lengths_m = adult_lengths_m(1.75)
    longer_m = lengths_m.copy()
    for side in ("Left", "Right"):
        longer_m[INDEX[f"{side}ForeArm"]] *= 1.2
    plain, longer = shape_body(shapes, lengths_m), shape_body(shapes, longer_m)
    reach_m = lengths_m[INDEX["LeftForeArm"]] * 0.2
    assert np.ptp(longer.vertices_m[:, 0]) - np.ptp(plain.vertices_m[:, 0]) == pytest.approx(2 * reach_m, abs=0.001)
    carried = plain.carriers[:, 0] == INDEX["Head"]
    np.testing.assert_allclose(longer.vertices_m[carried], plain.vertices_m[carried])
    # Upper arms are longer, and not thicker.
    carried = (plain.carriers[:, 0] == INDEX["LeftArm"]) & (plain.weights[:, 0] == 1.0)
    np.testing.assert_allclose(longer.vertices_m[carried, 1:], plain.vertices_m[carried, 1:], atol=1e-9)


def test_children_have_larger_heads_for_their_stature(shapes: BodyShapes) -> None:
    def breadth(stature_m: float) -> float:
        body = shape_body(shapes, adult_lengths_m(stature_m))
        of_head = (body.carriers[:, 0] == INDEX["Head"]) & (body.weights[:, 0] == 1.0)
        return float(np.ptp(body.vertices_m[of_head, 0])) / stature_m

    assert breadth(0.8) > 1.2 * breadth(1.3)
    assert breadth(1.3) > 1.1 * breadth(1.75)
    assert breadth(1.55) == pytest.approx(breadth(1.75))


def test_shapes_are_those_of_skeleton_at_rest(shapes: BodyShapes) -> None:
    assert shapes.joints_m.shape[1] == len(BODY_JOINTS)
    for joints_m in shapes.joints_m:
        for joint in WHOLE_SKELETON[1:]:
            assert joint.parent is not None
            way_m = joints_m[BODY_INDEX[joint.name]] - joints_m[BODY_INDEX[joint.parent]]
            length_m = float(np.linalg.norm(way_m))
            np.testing.assert_allclose(way_m, length_m * np.array(joint.rest_direction), atol=2e-4)


def test_skeleton_without_fingers_has_slightly_bent_hands(shapes: BodyShapes) -> None:
    straight, relaxed = (shape_body(shapes, adult_lengths_m(1.75, number)) for number in (64, 24))
    tips = straight.carriers[:, 0] == INDEX["LeftHandMiddle3"]
    assert set(relaxed.carriers[tips, 0]) == {INDEX["LeftHand"]}
    lower_m = straight.vertices_m[tips, 2].min() - relaxed.vertices_m[tips, 2].min()
    assert 0.01 < lower_m < 0.06
