import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import BODY_FEET, WHOLE_BODY, JointSet
from pipeline.export.writers import skeletons_json
from pipeline.motion.skeleton.model import SKELETON


def encoded(of: Reconstruction) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        paths: list[Path] = []
        for one in of.tracks:
            paths.append(Path(folder) / str(len(paths)))
            paths[-1].write_bytes(b"".join(skeletons_json.encode_track(one)))
        return b"".join(skeletons_json.join(of, paths))


def lines(content: bytes) -> list[bytes]:
    """Part of each track in a file."""
    return [line.removesuffix(b",") for line in content.splitlines()[1:-1]]


JOINTS = JointSet(("left_hip", "left_knee"), (("left_hip", "left_knee"),))


def track() -> Track3D:
    xyz_m = np.array([[[0.123449, -0.00001, 1.6], [np.nan] * 3], [[1.0, 2.0, 3.00005], [4.0, 5.0, np.nan]]])
    return Track3D(
        track_id=7,
        start_frame=3,
        xyz_m=xyz_m,
        score=np.array([[0.9304, 0.0], [0.5, 0.0]]),
        source=np.array([[Source.MEASURED, Source.ABSENT], [Source.INTERPOLATED, Source.PREDICTED]], dtype=np.int8),
        error_px=np.array([[3.144, np.nan], [np.nan, np.nan]]),
        views=np.array([[3, 0], [0, 0]]),
    )


def reconstruction(*tracks: Track3D) -> Reconstruction:
    motions = tuple(
        SkeletonMotion(
            one.track_id,
            f"person-{one.track_id}",
            one.start_frame,
            29.97,
            np.zeros(len(SKELETON)),
            np.zeros((one.num_frames, 3)),
            np.tile([0.0, 0.0, 0.0, 1.0], (one.num_frames, len(SKELETON), 1)),
            (),
        )
        for one in tracks
    )
    return Reconstruction((), JOINTS, Timebase(0.5, 29.97, 300), tracks, (), Animation(tracks, motions, None))


def test_everything_stands_where_contract_says() -> None:
    content = encoded(reconstruction(track()))
    assert json.loads(content) == {
        "schema_version": 1,
        "frame_rate_hz": 29.97,
        "start_time_s": 0.5,
        "num_frames": 300,
        "joint_names": ["left_hip", "left_knee"],
        "bones": [["left_hip", "left_knee"]],
        "tracks": [
            {
                "id": 7,
                "name": "person-7",
                "start_frame": 3,
                "positions_m": [[[0.1234, 0.0, 1.6], None], [[1.0, 2.0, 3.0], None]],
                "scores": [[0.93, 0.0], [0.5, 0.0]],
                "sources": ["m-", "ip"],
                "error_px": [[3.14, None], [None, None]],
                "uncertainty_m": None,
            }
        ],
    }


def test_uncertainty_is_in_tenths_of_millimetre(tmp_path: Path) -> None:
    certain = replace(track(), uncertainty_m=np.array([[0.01234, np.nan], [0.2, 0.00004]]))
    content = encoded(reconstruction(certain, track()))
    first, second = json.loads(content)["tracks"]
    assert first["uncertainty_m"] == [[0.0123, None], [0.2, 0.0]]
    assert second["uncertainty_m"] is None
    path = tmp_path / "person-7"
    for line in lines(content):
        path.write_bytes(line)
        assert skeletons_json.read_track_m(path).shape == (2, 2, 3)
    path.write_bytes(lines(content)[0].replace(b"[0.0123,null]", b"[0.0123,nu]"))
    with pytest.raises(json.JSONDecodeError):
        skeletons_json.read_track_m(path)


def test_bytes_are_strict_json_and_always_same() -> None:
    content = encoded(reconstruction(track(), track()))
    assert content == encoded(reconstruction(track(), track()))
    assert b"NaN" not in content
    assert b"-0.0," not in content
    assert len(json.loads(content)["tracks"]) == 2


def test_nobody_is_empty_list() -> None:
    assert json.loads(encoded(reconstruction()))["tracks"] == []


def test_numbers_that_json_does_not_know_are_refused() -> None:
    broken = Reconstruction((), JOINTS, Timebase(0.0, np.nan, 1), (), (), Animation((), (), None))
    with pytest.raises(ValueError, match="not JSON compliant"):
        encoded(broken)


@pytest.mark.parametrize("joints", [BODY_FEET, WHOLE_BODY])
def test_feet_and_hands_have_all_series(joints: JointSet, tmp_path: Path) -> None:
    num_joints = len(joints.names)
    rng = np.random.default_rng(0)
    sigma_m = rng.uniform(size=(3, num_joints))
    source = np.resize([Source.MEASURED, Source.PREDICTED, Source.INTERPOLATED], (3, num_joints)).astype(np.int8)
    larger = Track3D(
        track_id=1,
        start_frame=0,
        xyz_m=rng.normal(size=(3, num_joints, 3)),
        score=rng.uniform(size=(3, num_joints)),
        source=source,
        error_px=rng.uniform(size=(3, num_joints)),
        views=np.full((3, num_joints), 2),
        uncertainty_m=sigma_m,
    )
    content = encoded(replace(reconstruction(larger), joints=joints))
    document = json.loads(content)
    assert document["joint_names"] == list(joints.names)
    assert [tuple(bone) for bone in document["bones"]] == list(joints.bones)
    (written,) = document["tracks"]
    assert written["sources"] == ["".join("-mip"[one] for one in frame) for frame in source.tolist()]
    np.testing.assert_allclose(written["scores"], larger.score, atol=1e-3)
    np.testing.assert_allclose(written["uncertainty_m"], sigma_m, atol=1e-4)
    path = tmp_path / "person-1"
    path.write_bytes(*lines(content))
    read_m = skeletons_json.read_track_m(path)
    np.testing.assert_allclose(read_m, larger.xyz_m, atol=1e-4)
