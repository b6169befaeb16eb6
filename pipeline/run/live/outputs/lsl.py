"""LSL: people as streams of the Lab Streaming Layer, which LabRecorder records (package ``pylsl``, the extra ``lsl``).

``lsl://NAME?people=2`` has three streams a person: ``NAME-1-joints``, positions in metres in our world;
``NAME-1-angles``, joint angles in degrees; and ``NAME-1-quality``, a marker of who is there and how well known, at each
change and every second. Metadata follow the conventions of XDF for motion capture. Streams keep their person until the
person has been gone for two seconds; NaN is unknown.

Stamps are times on the clock of LSL at which an instant's own frames arrived, as the earliest ones did
(``live.clocks``): jitter moves no stamp.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np
import pylsl
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.joints import JointSet
from pipeline.motion import body_segments
from pipeline.motion.angles.compute import observable_angles
from pipeline.motion.skeleton.model import INDEX
from pipeline.run.live.clocks import StreamClock
from pipeline.run.live.outputs.output import LiveOutput, OutputStart
from pipeline.run.live.outputs.poses import person_name, world_rotations
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_BUFFER_S = 10
_FACTS_S = 1.0
_JOINTS = [(joint, side) for joint in body_segments.JOINTS for side in body_segments.joint_sides(joint)]
_SEGMENTS = {name: place for place, name in enumerate((None, *body_segments.SEGMENTS))}
_TURNING = [INDEX[segment.joint] for segment in body_segments.SEGMENTS.values()]
_AXES = np.array([segment.rest_from_segment for segment in body_segments.SEGMENTS.values()])


def pose_angles_deg(skeletons: Sequence[LiveSkeleton]) -> Float[np.ndarray, "people angles"]:
    """Joint angles of ``ANGLE_NAMES`` of each skeleton in degrees, in the principal ranges of their sequences."""
    turns = world_rotations(skeletons)[:, _TURNING]
    body = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix().reshape(*turns.shape[:2], 3, 3) @ _AXES
    segments = np.concatenate([np.broadcast_to(body_segments.WORLD, (len(turns), 1, 3, 3)), body], axis=1)
    angle_deg = np.empty((len(turns), len(body_segments.ANGLE_NAMES)))
    for sequence, rows in _SEQUENCES.items():
        proximal, distal, sides = zip(*((*ends, side) for _, side, ends in rows), strict=True)
        rotation = segments[:, proximal].swapaxes(-1, -2) @ segments[:, distal]
        is_left = np.array([side == "left" for side in sides])
        rotation[:, is_left] = body_segments.mirrored(rotation[:, is_left])
        turned_deg = np.degrees(body_segments.angles_rad(rotation, sequence))
        for row, (joint, side, _) in enumerate(rows):
            for angle in joint.angles:
                column = body_segments.ANGLE_NAMES.index(body_segments.angle_name(angle, side))
                angle_deg[:, column] = angle.sign * turned_deg[:, row, angle.rotation]
    return angle_deg


_Row = tuple[body_segments.AngleJoint, str | None, tuple[int, int]]
_SEQUENCES: dict[body_segments.Sequence, list[_Row]] = {}
for _joint, _side in _JOINTS:
    _proximal, _distal = body_segments.joint_segments(_joint, _side)
    _SEQUENCES.setdefault(_joint.sequence, []).append((_joint, _side, (_SEGMENTS[_proximal], _SEGMENTS[_distal])))


class _PersonStreams:
    """Streams of a slot."""

    def __init__(self, name: str, rate_hz: float, joints: Sequence[str], angles: Sequence[str]) -> None:
        positions = [(f"{joint}_{axis}", joint, f"Position{axis}", "meters") for joint in joints for axis in "XYZ"]
        turns = [(angle, angle, "Angle", "degrees") for angle in angles]
        self._angles = [body_segments.ANGLE_NAMES.index(angle) for angle in angles]
        self._joints = _outlet(f"{name}-joints", "MoCap", rate_hz, positions)
        self._turns = _outlet(f"{name}-angles", "MoCap", rate_hz, turns) if turns else None
        self._markers = _outlet(f"{name}-quality", "Markers", pylsl.IRREGULAR_RATE, [("quality", "", "Marker", "")])
        self._unknown_m = np.full((len(joints), 3), np.nan)
        self._quality, self._told_s = "", 0.0

    def push(self, person: LivePerson | None, angle_deg: np.ndarray, stamp_s: float) -> int:
        """Push an instant of a person; return the number of samples."""
        self._joints.push_sample((self._unknown_m if person is None else person.xyz_m).ravel().tolist(), stamp_s)
        if self._turns is not None:
            self._turns.push_sample(angle_deg[self._angles].tolist(), stamp_s)
        state = "located" if person is None or person.skeleton is None else "tracked"
        quality = "absent" if person is None else f"{person_name(person.id)} {state}"
        if quality != self._quality or stamp_s - self._told_s >= _FACTS_S:
            self._quality, self._told_s = quality, stamp_s
            self._markers.push_sample([quality], stamp_s)
        return 1 + (self._turns is not None)


def _outlet(name: str, kind: str, rate_hz: float, channels: Sequence[tuple[str, str, str, str]]) -> pylsl.StreamOutlet:
    form = pylsl.cf_string if kind == "Markers" else pylsl.cf_float32
    info = pylsl.StreamInfo(name, kind, len(channels), rate_hz, form, f"multicap-{name}")
    info.desc().append_child("acquisition").append_child_value("manufacturer", "Multicap")
    listed = info.desc().append_child("channels")
    for label, marker, channel_type, unit in channels:
        channel = listed.append_child("channel").append_child_value("label", label)
        for field, value in (("marker", marker), ("type", channel_type), ("unit", unit)):
            if value:
                channel.append_child_value(field, value)
    return pylsl.StreamOutlet(info, max_buffered=_BUFFER_S)


class LslOutput(LiveOutput):
    """Output of LSL; see ``LiveOutput``. Streams are there until the end, so that recorders find them before people."""

    def __init__(self, start: OutputStart) -> None:
        self._num_people = int(start.address.options.get("people", 1))
        super().__init__(start, self._num_people)
        self._clock = StreamClock()

    def __enter__(self) -> Self:
        names = [f"{self.address.host}-{slot}" for slot in range(1, self._num_people + 1)]
        angles = observable_angles(JointSet(self.joints, ()))
        self._streams = [_PersonStreams(name, self.rate_hz, self.joints, angles) for name in names]
        return self

    def __exit__(self, *error: object) -> None:
        self._streams.clear()

    def send(self, instant: LiveInstant) -> int:
        """Send the people of an instant; see ``LiveOutput``."""
        self._clock.arrive(instant.time_s, pylsl.local_clock() - instant.lag_s)
        stamp_s = self._clock.capture_s(instant.time_s)
        in_sight = {person.id: person for person in instant.people}
        people = [person and in_sight.get(person.id) for person in self.slots.update(instant)]
        skeletons = {slot: person.skeleton for slot, person in enumerate(people) if person and person.skeleton}
        angles = dict(zip(skeletons, pose_angles_deg(list(skeletons.values())), strict=True)) if skeletons else {}
        unknown = np.full(len(body_segments.ANGLE_NAMES), np.nan)
        return sum(
            streams.push(person, angles.get(slot, unknown), stamp_s)
            for slot, (streams, person) in enumerate(zip(self._streams, people, strict=True))
        )
