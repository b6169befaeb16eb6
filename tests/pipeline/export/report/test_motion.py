"""Motion of a report: the viewer's description with its frames, thinned out evenly."""

import base64
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.report.contents import choose_stride, embed_motion
from pipeline.export.viewer.frames import ABSENT
from pipeline.motion.body import installed
from pipeline.motion.skeleton.model import forward_kinematics
from tests.pipeline.export.viewer.takes import take
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker


def embedded(people: Reconstruction, **options: Any) -> dict[str, Any]:
    views = person_views(people)
    return embed_motion(people, views, quality_report(people, views), **options)


def read_m(document: dict[str, Any], field: str) -> list[np.ndarray]:
    """Positions of a field of each person, from the records of the document."""
    content, num_bytes = base64.b64decode(document["frames"]), document["record"]["num_bytes"]
    num_values = 3 * len(document["joint_names"] if field == "joints" else document["skeleton"]["names"])
    assert num_bytes % 4 == 0
    found, place = [], 0
    for person in document["people"]:
        rows = []
        for frame in range(person["start_frame"], person["start_frame"] + person["num_frames"]):
            if frame % document["stride"]:
                continue
            origin_m = np.frombuffer(content, "<f4", 3, place + document["record"]["offsets"]["origin_m"])
            steps = np.frombuffer(content, "<i2", num_values, place + document["record"]["offsets"][field])
            known = np.where(steps == ABSENT, np.nan, steps) * person["position_step_m"]
            rows.append(origin_m + known.reshape(-1, 3))
            place += num_bytes
        found.append(np.array(rows))
    assert place == len(content)
    return found


def test_frames_hold_skeletons_and_joints() -> None:
    one_m, other_m = walker(40), walker(30) + 3.0
    one_m[1, 2] = np.nan
    people = take(track_of(one_m, 1, 7), track_of(other_m, 2, 50))
    document = embedded(people)
    assert document["stride"] == 1
    for found_m, motion in zip(read_m(document, "skeleton"), people.motions, strict=True):
        np.testing.assert_allclose(found_m, forward_kinematics(motion), atol=1e-4)
    for found_m, track in zip(read_m(document, "joints"), people.tracks, strict=True):
        np.testing.assert_allclose(found_m, track.xyz_m, atol=1e-4)


def test_take_without_people_has_no_frames() -> None:
    document = embedded(take(num_frames=10))
    assert (document["people"], document["frames"]) == ([], "")


def test_long_take_is_thinned_evenly() -> None:
    installed.install()
    people = take(track_of(walker(60), 1, 7), track_of(walker(30) + 1.0, 2, 50))
    num_bytes = embedded(people)["record"]["num_bytes"]
    thin = embedded(people, max_bytes=30 * num_bytes, shapes=installed.load())
    assert thin["stride"] == 3
    assert thin["body"] is not None
    # Frames 9, 12, ... of the first person, 51, 54, ... of the second.
    first_m, second_m = read_m(thin, "skeleton")
    assert (len(first_m), len(second_m)) == (20, 10)
    expected_m = [forward_kinematics(motion) for motion in people.motions]
    np.testing.assert_allclose(first_m, expected_m[0][2::3], atol=1e-4)
    np.testing.assert_allclose(second_m, expected_m[1][1::3], atol=1e-4)


@pytest.mark.parametrize("num_frames", [[1], [1, 1, 1], [10, 3], [100_000, 7]])
def test_stride_fits_every_take(num_frames: list[int]) -> None:
    stride = choose_stride(num_frames, 100, 1000)
    assert sum(-(-num // stride) for num in num_frames) <= max(10, len(num_frames))
