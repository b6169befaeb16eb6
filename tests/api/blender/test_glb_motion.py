"""GLB files as the extension reads them: the service's, and files that somebody changed."""

import contextlib
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from api.blender.extension.answers import RequestError
from api.blender.extension.glb_motion import PersonMotion, check_glb, read_motion
from pipeline.export.writers import glb
from pipeline.motion.skeleton.model import find_skeleton, forward_kinematics
from tests.pipeline.export.writers.test_bvh import walk, with_fingers

RATE_HZ = 30000 / 1001


@pytest.fixture(scope="module")
def content() -> bytes:
    return b"".join(glb.encode(with_fingers(walk(40, RATE_HZ)), np.zeros(3)))


def parts(content: bytes) -> tuple[dict[str, Any], bytes]:
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def whole(document: Any, numbers: bytes) -> bytes:
    head = json.dumps(document).encode()
    head += b" " * (-len(head) % 4)
    size = 28 + len(head) + len(numbers)
    described = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(head), b"JSON") + head
    return described + struct.pack("<I4s", len(numbers), b"BIN\0") + numbers


def posed_m(motion: PersonMotion, frame: int) -> dict[str, np.ndarray]:
    """World positions of joints in a frame, by SciPy."""
    places: dict[str, np.ndarray] = {}
    turns: dict[str, Rotation] = {}
    for joint, parent in motion.parents.items():
        w, *xyz = motion.turns[joint][frame] if joint in motion.turns else (1.0, 0.0, 0.0, 0.0)
        turn = Rotation.from_quat([*xyz, w])
        if parent is None:
            places[joint], turns[joint] = np.array(motion.roots_m[frame]), turn
        else:
            places[joint] = places[parent] + turns[parent].apply(motion.offsets_m[joint])
            turns[joint] = turns[parent] * turn
    return places


def test_joints_are_where_service_has_them(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "0.glb"
    path.write_bytes(content)
    facts, motion = check_glb(path), read_motion(path)
    assert (facts.num_frames, motion.num_frames) == (40, 40)
    assert facts.frame_rate_hz == pytest.approx(RATE_HZ)
    expected_m = forward_kinematics(with_fingers(walk(40, RATE_HZ)))
    for frame in (0, 17, 39):
        found_m = posed_m(motion, frame)
        for index, joint in enumerate(find_skeleton(expected_m.shape[1])):
            np.testing.assert_allclose(found_m[joint.name], expected_m[frame, index], atol=1e-5)


Document = dict[str, Any]


def of_buffer(document: Document) -> None:
    document["buffers"][0]["uri"] = "../../../etc/passwd"


def of_picture(document: Document) -> None:
    document["images"] = [{"uri": "file:///etc/passwd"}]


def view_behind_the_end(document: Document) -> None:
    document["bufferViews"][-1]["byteLength"] += 1000


def huge_accessor(document: Document) -> None:
    document["accessors"][0]["count"] = 1 << 39


def negative_offset(document: Document) -> None:
    document["accessors"][0]["byteOffset"] = -4


def child_that_is_not_there(document: Document) -> None:
    document["nodes"][0]["children"] = [10_000]


def two_animations(document: Document) -> None:
    document["animations"] *= 2


def no_rate(document: Document) -> None:
    del document["animations"][0]["extras"]


def rate_of_nothing(document: Document) -> None:
    document["animations"][0]["extras"]["frame_rate_hz"] = 0


def list_of_lists(document: Document) -> None:
    document["nodes"] = [[]]


CHANGES = [
    of_buffer,
    of_picture,
    view_behind_the_end,
    huge_accessor,
    negative_offset,
    child_that_is_not_there,
    two_animations,
    no_rate,
    rate_of_nothing,
    list_of_lists,
]


@pytest.mark.parametrize("change", CHANGES)
def test_changed_descriptions_are_refused(content: bytes, change: Callable[[Document], None], tmp_path: Path) -> None:
    document, numbers = parts(content)
    change(document)
    path = tmp_path / "0.glb"
    path.write_bytes(whole(document, numbers))
    for read in (check_glb, read_motion):
        with pytest.raises(RequestError, match="GLB file"):
            read(path)


@pytest.mark.parametrize("change", ["no object", "deep", "other version", "cut off", "longer", "short", "empty"])
def test_broken_files_are_refused(content: bytes, change: str, tmp_path: Path) -> None:
    numbers = parts(content)[1]
    path = tmp_path / "0.glb"
    path.write_bytes(
        {
            "no object": whole([], numbers),
            "deep": whole(None, numbers).replace(b"null", b"[" * 4),
            "other version": b"glTF\x01" + content[5:],
            "cut off": content[:-1],
            "longer": content + b"\0",
            "short": content[:11],
            "empty": b"",
        }[change]
    )
    for read in (check_glb, read_motion):
        with pytest.raises(RequestError, match="GLB file"):
            read(path)


def test_numbers_that_are_not_finite_are_refused(content: bytes, tmp_path: Path) -> None:
    document, numbers = parts(content)
    (sampler, *_) = document["animations"][0]["samplers"]
    start = document["bufferViews"][document["accessors"][sampler["output"]]["bufferView"]]["byteOffset"]
    path = tmp_path / "0.glb"
    path.write_bytes(whole(document, numbers[:start] + struct.pack("<f", np.nan) + numbers[start + 4 :]))
    with pytest.raises(RequestError):
        read_motion(path)


def test_joint_above_itself_is_refused(content: bytes, tmp_path: Path) -> None:
    document, numbers = parts(content)
    root = document["skins"][0]["joints"][0]
    end = next(number for number, node in enumerate(document["nodes"]) if node.get("name") == "HeadEnd")
    document["nodes"][end]["children"] = [root]
    path = tmp_path / "0.glb"
    path.write_bytes(whole(document, numbers))
    with pytest.raises(RequestError):
        read_motion(path)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 4000), byte=st.binary(min_size=1, max_size=6))
def test_damaged_bytes_raise_nothing_else(content: bytes, at: int, byte: bytes, tmp_path: Path) -> None:
    path = tmp_path / "0.glb"
    path.write_bytes(content[:at] + byte + content[at + len(byte) :])
    for read in (check_glb, read_motion):
        with contextlib.suppress(RequestError):
            read(path)
