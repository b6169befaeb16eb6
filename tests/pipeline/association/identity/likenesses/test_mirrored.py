"""Mirror images, and people who do the same."""

from collections.abc import Sequence

import numpy as np
import pytest

from pipeline.association.identity.likenesses.find import Likenesses, find_likenesses
from pipeline.association.identity.likenesses.mirrored import find_mirror
from pipeline.core.data.people import Track3D
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import center_in_world
from pipeline.validation.simulation.motion.script import Gesture, Stay
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.pipeline.association.identity.likenesses.scenes import OTHERS, RATE_HZ, mirrored, moving, poster, track

RING = build_cameras(Rig(Layout.RING, 6, (4.0, 4.0), 2.2), np.random.default_rng(0))
ALONG_X = (1.0, 0.0, 0.0)


def behind(normal: Sequence[float], offset_m: float) -> np.ndarray:
    """Cameras behind a plane."""
    return np.array([center_in_world(camera) @ np.array(normal) > offset_m for camera in RING])


def likenesses(tracks: Sequence[Track3D], blind: np.ndarray | None = None) -> Likenesses:
    """Likenesses of people whom all cameras see, but those that are blind to the last person."""
    sees = [np.ones((person.num_frames, len(RING)), bool) for person in tracks]
    if blind is not None:
        sees[-1][:, blind] = False
    return find_likenesses(tracks, lambda number: sees[number], RING, COCO_17, RATE_HZ)


@pytest.mark.parametrize(("normal", "offset_m"), [(ALONG_X, 2.2), ((0.6, 0.8, 0.0), 1.9), ((0.0, -1.0, 0.0), 1.6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_an_image_is_found_with_its_plane(normal: tuple[float, ...], offset_m: float, seed: int) -> None:
    person, image = track(moving(seed), seed), track(mirrored(moving(seed), normal, offset_m), seed + 9, 0.03)
    found = likenesses([person, image], behind(normal, offset_m))
    assert not found.still
    (of_second,) = found.images
    assert (of_second.number, of_second.original, of_second.num_frames) == (1, 0, 240)
    sign = np.sign(of_second.normal @ np.array(normal))
    np.testing.assert_allclose(sign * of_second.normal, normal, atol=0.02)
    assert of_second.normal.max() > -of_second.normal.min()
    assert sign * of_second.offset_m == pytest.approx(offset_m, abs=0.03)
    assert of_second.error_m < 0.03
    assert found.others(2) == [0]


def test_an_image_is_found_of_a_person_whose_feet_nobody_saw() -> None:
    """Joints that were never located neither count nor warn."""
    person_m = moving(3)
    person_m[:, COCO_17.indices(("left_ankle", "right_ankle"))] = np.nan
    person, image = track(person_m, 3), track(mirrored(moving(3), ALONG_X, 2.2), 12)
    assert [found.number for found in likenesses([person, image], behind(ALONG_X, 2.2)).images] == [1]


def test_the_image_may_come_first() -> None:
    person, image = track(moving(3)), track(mirrored(moving(3), ALONG_X, 2.2), 1)
    sees = [np.tile(~behind(ALONG_X, 2.2), (240, 1)), np.ones((240, 6), bool)]
    found = find_likenesses([image, person], lambda number: sees[number], RING, COCO_17, RATE_HZ)
    assert [(image.number, image.original) for image in found.images] == [(0, 1)]


def test_somebody_whom_cameras_behind_the_plane_see_is_real() -> None:
    """Dancers who mirror each other exactly."""
    assert behind(ALONG_X, 1.6).any()
    pair = track(moving(2)), track(mirrored(moving(2), ALONG_X, 1.6), 1)
    assert find_mirror(*pair, COCO_17, RATE_HZ) is not None
    assert likenesses(pair).images == []


def test_dancers_who_mirror_each_other_for_a_while_are_real() -> None:
    other_m = mirrored(moving(2), ALONG_X, 2.2)
    other_m[160:] += np.linspace(0.0, 0.6, 80)[:, None, None] * [0.3, 1.0, 0.0]
    assert likenesses([track(moving(2)), track(other_m, 1)], behind(ALONG_X, 2.2)).images == []


@pytest.mark.parametrize("late", [4, 6, 9])
def test_dancers_are_late(late: int) -> None:
    """A fifth of a second, as of people who follow each other."""
    other_m = mirrored(moving(2), ALONG_X, 2.2)
    pair = [track(moving(2)[late:]), track(other_m[:-late], 1)]
    assert likenesses(pair, behind(ALONG_X, 2.2)).images == []


def test_dancers_who_do_the_same_side_by_side_are_no_images() -> None:
    same_m = moving(2) + np.array([0.0, 2.5, 0.0])
    assert likenesses([track(moving(2)), track(same_m, 1)], behind((0.0, 1.0, 0.0), 1.25)).images == []


def test_left_and_right_are_exchanged_in_a_mirror() -> None:
    unnamed_m = mirrored(moving(1), ALONG_X, 2.2)[:, OTHERS]
    assert find_mirror(track(moving(1)), track(unnamed_m, 1), COCO_17, RATE_HZ) is None


def test_people_who_stand_opposite_each_other_tell_nothing() -> None:
    still_m = moving(1, cues=(Stay(8.0, Gesture.IDLE),))
    assert find_mirror(track(still_m), track(mirrored(still_m, ALONG_X, 2.2), 1), COCO_17, RATE_HZ) is None


def test_a_second_in_common_tells_nothing() -> None:
    image = track(mirrored(moving(1)[190:], ALONG_X, 2.2), 1, start_frame=190)
    assert find_mirror(track(moving(1)), image, COCO_17, RATE_HZ) is None


@pytest.mark.parametrize(("num_frames", "num_images"), [(100, 0), (180, 1)])
def test_an_image_is_one_for_most_of_its_time(num_frames: int, num_images: int) -> None:
    person, image = track(moving(1)[:num_frames]), track(mirrored(moving(1), ALONG_X, 2.2), 1)
    assert len(likenesses([person, image], behind(ALONG_X, 2.2)).images) == num_images


def test_pictures_and_images_leave_the_others_and_all_if_there_are_none() -> None:
    image = track(mirrored(moving(1), ALONG_X, 2.2), 4)
    tracks = [track(poster(1)), track(moving(1), 2), track(moving(5), 3), image]
    found = likenesses(tracks, behind(ALONG_X, 2.2))
    assert [person.number for person in found.still] == [0]
    assert [(image.number, image.original) for image in found.images] == [(3, 1)]
    assert found.others(4) == [1, 2]
    assert likenesses(tracks[:1]).others(1) == [0]
    assert likenesses([]).others(0) == []
