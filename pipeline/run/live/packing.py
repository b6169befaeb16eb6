"""Packets of live captures and arrays: keypoints of a camera's frame, instants with their people."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera
from pipeline.run.live.packets import PERSON_HEAD, Dropped, InstantHead, KeypointsHead
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_FLOAT = np.dtype("<f4")
_DIGITS = 5


def pack_keypoints(
    camera: int,
    time_s: float,
    points_px: Float[np.ndarray, "people points 2"],
    score: Float[np.ndarray, "people points"],
) -> bytes:
    """Packet of a camera's frame.

    ``camera``: place of the camera in the list of the message ``ready``. ``points_px``: points of the layout in pixels,
    NaN where a point was not found. ``score``: confidence in each point, 0 to 1; 0 where it was not found.
    """
    people = np.concatenate([points_px, np.asarray(score)[..., None]], -1).astype(_FLOAT)
    people[~np.isfinite(people).all(-1)] = 0.0
    num_people, num_points, _ = people.shape
    return KeypointsHead(camera, num_people, num_points, time_s).encode() + people.tobytes()


def unpack_keypoints(packet: bytes) -> tuple[KeypointsHead, Float[np.ndarray, "people points 3"]]:
    """Head and points of a packet that was checked."""
    head = KeypointsHead.decode(packet)
    if head is None:
        raise ValueError("These bytes are not a packet of keypoints.")
    numbers = np.frombuffer(KeypointsHead.packet_body(packet), _FLOAT).astype(np.float64)
    return head, numbers.reshape(head.num_people, head.num_points, 3)


def pack_instant(instant: LiveInstant, num_joints: int, num_bones: int, sequence: int) -> bytes:
    """Packet of an instant; numbers of joints and bones that are not known are NaN."""
    head = InstantHead(len(instant.people), num_joints, num_bones, instant.time_s, instant.lag_s, sequence)
    return b"".join([head.encode(), *(piece for person in instant.people for piece in _record(person, num_bones))])


def _record(person: LivePerson, num_bones: int) -> Iterator[bytes]:
    yield PERSON_HEAD.pack(person.id, int(person.skeleton is not None))
    yield np.asarray(person.xyz_m, _FLOAT).tobytes()
    if person.skeleton is None:
        yield np.full(3 + 8 * num_bones, np.nan, _FLOAT).tobytes()
    else:
        pose = person.skeleton
        for values in (pose.root_m, pose.parent_from_joint, pose.bone_length_m, pose.joint_m):
            yield np.asarray(values, _FLOAT).tobytes()


def unpack_instant(packet: bytes) -> tuple[LiveInstant, Dropped]:
    """Instant of a packet, and numbers of dropped messages; ``ValueError`` if it is no packet of an instant."""
    head = InstantHead.decode(packet)
    body = InstantHead.packet_body(packet)
    people = tuple(
        _person(body[start : start + head.person_bytes], head)
        for start in range(0, head.num_people * head.person_bytes, head.person_bytes)
    )
    return LiveInstant(head.time_s, people, head.lag_s), head.dropped


def _person(record: memoryview, head: InstantHead) -> LivePerson:
    number, has_skeleton = PERSON_HEAD.unpack_from(record)
    bones = head.num_bones
    ends = np.cumsum([3 * head.num_joints, 3, 4 * bones, bones])
    located, root, turns, lengths, joints = np.split(
        np.frombuffer(record[PERSON_HEAD.size :], _FLOAT).astype(np.float64), ends
    )
    skeleton = LiveSkeleton(root, turns.reshape(bones, 4), lengths, joints.reshape(bones, 3))
    return LivePerson(number, located.reshape(head.num_joints, 3), skeleton if has_skeleton else None)


def described_camera(camera: Camera) -> dict[str, object]:
    """Camera as viewers draw it, in metres, Z up."""
    pose = camera.cam_from_world
    return {
        "name": camera.name,
        "size_px": camera.size_px,
        "matrix": camera.matrix.tolist(),
        "cam_from_world": {"rotation": pose.rotation.tolist(), "translation_m": pose.translation_m.tolist()},
    }


def instant_json(instant: LiveInstant, sequence: int) -> dict[str, Any]:
    """Instant as values of JSON; a joint that is not known is ``None``."""
    return {
        "sequence": sequence,
        "time_s": instant.time_s,
        "lag_s": round(instant.lag_s, _DIGITS),
        "people": [
            {"id": person.id, "joints_m": _points(person.xyz_m), "skeleton": _skeleton(person.skeleton)}
            for person in instant.people
        ],
    }


def _skeleton(skeleton: LiveSkeleton | None) -> dict[str, Any] | None:
    if skeleton is None:
        return None
    return {
        "root_m": skeleton.root_m.round(_DIGITS).tolist(),
        "rotations_xyzw": skeleton.parent_from_joint.round(_DIGITS).tolist(),
        "bone_lengths_m": skeleton.bone_length_m.round(_DIGITS).tolist(),
        "joints_m": skeleton.joint_m.round(_DIGITS).tolist(),
    }


def _points(xyz_m: Float[np.ndarray, "joints 3"]) -> list[list[float] | None]:
    known = np.isfinite(xyz_m).all(-1)
    points: list[list[float] | None] = xyz_m.round(_DIGITS).tolist()
    return [point if is_known else None for point, is_known in zip(points, known, strict=True)]


def instant_of_json(message: dict[str, Any]) -> tuple[LiveInstant, Dropped]:
    """Instant of a message ``instant`` in JSON, and numbers of dropped messages."""
    people = tuple(_person_of_json(person) for person in message["people"])
    dropped = Dropped(message["dropped"]["input"], message["dropped"]["output"])
    return LiveInstant(message["time_s"], people, message["lag_s"]), dropped


def _person_of_json(person: dict[str, Any]) -> LivePerson:
    nowhere = [np.nan] * 3
    located = np.array([nowhere if point is None else point for point in person["joints_m"]], np.float64)
    if (pose := person["skeleton"]) is None:
        return LivePerson(person["id"], located, None)
    skeleton = LiveSkeleton(
        np.array(pose["root_m"], np.float64),
        np.array(pose["rotations_xyzw"], np.float64),
        np.array(pose["bone_lengths_m"], np.float64),
        np.array(pose["joints_m"], np.float64),
    )
    return LivePerson(person["id"], located, skeleton)
