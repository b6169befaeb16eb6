"""Named scenes of simulated people and cameras, and their simulation with exact ground truth.

A simulation has files: the input of ``pipeline.capture.keypoints``, and the ground truth ::

    calibration.json
    timestamps.csv                                  camera,frame,time_s
    keypoints/<camera>/frame_000000000123_keypoints.json
    truth.npz                                       xyz_m, joint_names, angle_deg, angle_names, frame_rate_hz,
                                                    start_time_s
"""

import csv
import io
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, cast, get_args

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY, JointSet
from pipeline.core.problems.finding_codes import NEGATIVE_SEED, UNKNOWN_JOINTS, UNKNOWN_SCENE, WRONG_NUMBER_OF_VIEWS
from pipeline.motion.angles.compute import segment_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.validation.simulation.motion.director import Cast, PlaceExchange, exchange, improvise
from pipeline.validation.simulation.motion.performance import joints_at, perform, segments_at
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay, Turn, Walk
from pipeline.validation.simulation.rigs import Clock, Layout, Rig, build_cameras, choose_views, frame_times
from pipeline.validation.simulation.views.detector import DetectorAccuracy, detect
from pipeline.validation.simulation.views.extremities import detect_extremities
from pipeline.validation.simulation.views.faults import Faults
from pipeline.validation.simulation.views.fields import Sketch, sketch
from pipeline.validation.simulation.views.occlusion import Box

JointsAt = Callable[[Float[np.ndarray, " times"]], Float[np.ndarray, "times joints 3"]]
SegmentsAt = Callable[[Float[np.ndarray, " times"]], Mapping[str, Float[np.ndarray, "times 3 3"]]]

Joints = Literal["body", "feet", "whole"]
"""Joints that are simulated: the body's, with heels and big toes, or with fingers too."""
JOINT_SETS: Mapping[Joints, JointSet] = {"body": COCO_17, "feet": BODY_FEET, "whole": WHOLE_BODY}
"""Joints of the detections and of the truth by choice."""

Act = Callable[[float, np.random.SeedSequence, JointSet], list[tuple[JointsAt, SegmentsAt]]]
"""People of other motions than scripts, from the duration of a recording and a seed: their joints and segments."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Scene: all settings of a simulation except the seed.

    ``rig``, ``clock``, ``detector``: cameras, their frame times and their 2D detector. ``cast``: people who improvise
    or exchange places, the roles of people with scripts, or people of other motions. ``boxes``: furniture that hides
    people and that they walk around. ``duration_s``: length of the recording.
    """

    rig: Rig
    cast: Cast | PlaceExchange | tuple[Role, ...] | Act
    clock: Clock = field(default_factory=Clock)
    detector: DetectorAccuracy = field(default_factory=DetectorAccuracy)
    boxes: tuple[Box, ...] = ()
    duration_s: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Recording of a scene and its ground truth."""

    cameras: tuple[Camera, ...]  # Exact calibration of the cameras
    # Frame times and detections by camera name
    times: Mapping[str, FrameTimes]
    detections: Mapping[str, Detections]
    # Person (row of ``truth_m``) of each detection by camera name, ``UNASSIGNED`` for false positives
    identities: Mapping[str, Int[np.ndarray, " _"]]
    joints: JointSet  # Joints of the detections and of the truth
    timebase: Timebase  # Frames of the truth
    truth_m: Float[np.ndarray, "people frames joints 3"]  # World positions of the joints, NaN while a person is absent
    # True joint angles of ``body_segments.ANGLE_NAMES`` in degrees; NaN while a person is absent, and of segments
    # that are not simulated
    truth_deg: Float[np.ndarray, "people frames angles"]
    present: Bool[np.ndarray, "people frames"]  # True if each person is present, visible or not
    # Content of each camera's heatmaps and part affinity fields; see ``views.fields.render``
    sketches: tuple[Sketch, ...]


def _greeting(x: float, y: float, hand_s: float) -> tuple[Role, Role]:
    """Two people meet, shake hands, talk and part."""
    meeting = (x, y, 1.02)
    return (
        Role(
            (x - 2.5, y), 0.0,
            (Walk((x - 0.38, y)), Turn(0.0), Stay(hand_s, Gesture.SHAKE_HANDS, meeting), Stay(5.0, Gesture.TALK),
             Stay(3.0), Stay(hand_s, Gesture.SHAKE_HANDS, meeting), Walk((x - 2.0, y - 1.2))),
        ),
        Role(
            (x + 2.5, y), np.pi,
            (Walk((x + 0.38, y)), Turn(np.pi), Stay(hand_s, Gesture.SHAKE_HANDS, meeting), Stay(3.0),
             Stay(5.0, Gesture.TALK), Stay(hand_s, Gesture.SHAKE_HANDS, meeting), Walk((x + 2.0, y + 1.2))),
        ),
    )  # fmt: skip


def _touching(x: float, y: float, gap_m: float, gesture: Gesture, hand_height_m: float) -> tuple[Role, Role]:
    """Two people meet, touch for four seconds, and touch again."""
    meeting = (x, y, hand_height_m)
    acts = Stay(4.0, gesture, meeting), Stay(1.0), Stay(4.0, gesture, meeting)
    return (
        Role((x - 1.0, y), 0.0, (Walk((x - gap_m / 2, y)), Turn(0.0), *acts)),
        Role((x + 1.0, y), np.pi, (Walk((x + gap_m / 2, y)), Turn(np.pi), *acts)),
    )


def _to_and_fro(y: float, far_m: float, speed_m_s: float, num_ways: int) -> Role:
    """A person walks or runs from side to side."""
    ways = (
        cue for k in range(num_ways) for cue in (Walk(((-1) ** k * far_m, y), speed_m_s), Turn(np.pi * ((k + 1) % 2)))
    )
    return Role((-far_m, y), 0.0, tuple(ways))


def _showing_hands(x: float, facing_rad: float) -> Role:
    """A person shows postures of the fingers, talks, and rests the hands in between."""
    acts = Stay(5.5, Gesture.HANDS), Stay(1.5), Stay(4.0, Gesture.TALK), Stay(1.0)
    return Role((x, 0.0), facing_rad, (Stay(0.5), *acts, *acts))


_ACTIVE = (
    Gesture.IDLE, Gesture.TALK, Gesture.WAVE, Gesture.POINT, Gesture.CROUCH, Gesture.JUMP, Gesture.PUNCH,
    Gesture.SWING,
)  # fmt: skip
_SHELVES = (Box((-3.5, 1.2, 0.0), (-1.0, 1.7, 1.5)), Box((1.0, -1.7, 0.0), (3.5, -1.2, 1.5)))
_LONG_SHELVES = (
    Box((-6.0, 2.0, 0.0), (-2.0, 2.6, 1.6)),
    Box((2.0, 2.0, 0.0), (6.0, 2.6, 1.6)),
    Box((-6.0, -2.6, 0.0), (-2.0, -2.0, 1.6)),
    Box((2.0, -2.6, 0.0), (6.0, -2.0, 1.6)),
)
_ROOM_RIG = Rig(Layout.RING, 4, (4.0, 4.0), 2.2, focal_px=760.0)

# Rig of people close together under a dome, as in the paper's Panoptic scenes.
_DOME_RIG = Rig(Layout.DOME, 31, (4.5, 4.5), 0.9, (1920, 1080), 1000.0)


def _crowd(num_people: int) -> Scene:
    gestures = (*_ACTIVE[:4], Gesture.CROUCH)
    return Scene(_DOME_RIG, Cast(num_people, (1.8, 1.8), gap_m=0.4, walking=0.25, gestures=gestures), duration_s=6.0)


SCENES: Mapping[str, Scene] = {
    "room": Scene(_ROOM_RIG, Cast(3, (3.0, 3.0), gestures=_ACTIVE)),
    "store": Scene(
        Rig(Layout.CEILING, 12, (5.0, 4.0), 3.2, focal_px=650.0, target_height_m=0.8),
        Cast(4, (8.0, 5.0), walking=0.7),
        Clock(10.0),
        boxes=_SHELVES,
    ),
    "store-large": Scene(
        Rig(Layout.CEILING, 28, (8.5, 6.5), 3.6, focal_px=700.0, target_height_m=0.8),
        Cast(16, (14.0, 10.0), walking=0.7),
        Clock(10.0),
        DetectorAccuracy(faults=Faults(miss_body=0.10)),
        boxes=_LONG_SHELVES,
    ),
    "outdoor": Scene(
        Rig(Layout.RING, 6, (14.0, 11.0), 3.0, (1920, 1080), 1500.0, distortion=(-0.05, 0.01, 0.0002, 0.0, 0.0)),
        Cast(5, (10.0, 8.0), walking=0.8, gestures=_ACTIVE),
        Clock(50.0),
    ),
    "unsynchronised": Scene(
        _ROOM_RIG,
        Cast(3, (3.0, 3.0), gestures=_ACTIVE),
        Clock(30.0, camera_rates_hz=(30.0, 25.0, 24.0, 30.0), random_phase=True, dropped=0.03),
    ),
    "crowd": _crowd(7),
    **{f"crowd-{num_people}": _crowd(num_people) for num_people in (2, 3, 5)},
    "exchange": Scene(
        Rig(Layout.RING, 6, (4.0, 4.0), 2.4, focal_px=760.0),
        PlaceExchange(7, gap_m=0.5),
        detector=DetectorAccuracy(noise_m=0.015, faults=Faults(miss_joint=0.05, miss_body=0.2, mix=0.3, memory_s=0.3)),
        duration_s=20.0,
    ),
    "contact": Scene(
        Rig(Layout.RING, 8, (4.5, 4.0), 2.4, (1920, 1080), 1000.0),
        (
            *_touching(-1.3, -0.8, 0.8, Gesture.CLAP, 1.3),
            *_touching(1.3, -0.8, 0.76, Gesture.SHAKE_HANDS, 1.02),
            *_touching(0.0, 1.0, 0.36, Gesture.HUG, 1.3),
        ),
        duration_s=12.0,
    ),
    "handshake": Scene(
        Rig(Layout.RING, 6, (5.0, 5.0), 2.4),
        (*_greeting(0.0, -1.2, 3.0), *_greeting(0.3, 1.2, 4.0)),
        duration_s=20.0,
    ),
    "walk": Scene(
        Rig(Layout.RING, 6, (5.5, 4.5), 2.4, focal_px=800.0),
        (_to_and_fro(-0.8, 2.5, 1.2, 8), _to_and_fro(0.8, 2.5, 0.9, 8)),
        duration_s=20.0,
    ),
    "hands": Scene(
        Rig(Layout.RING, 6, (3.2, 3.2), 1.8, (1920, 1080), 1200.0, target_height_m=1.05),
        (_showing_hands(-0.6, 0.0), _showing_hands(0.6, np.pi)),
        duration_s=20.0,
    ),
    "sports": Scene(
        Rig(Layout.RING, 8, (8.5, 6.5), 2.6, (1920, 1080), 1100.0),
        (
            _to_and_fro(-1.5, 5.0, 3.2, 8),
            Role((-1.5, 1.5), -1.6, (Stay(20.0, Gesture.JUMP),)),
            Role((1.5, 1.5), -1.6, (Stay(8.0, Gesture.JUMP), Stay(4.0, Gesture.PUNCH), Stay(8.0, Gesture.JUMP))),
        ),
        Clock(50.0),
        duration_s=20.0,
    ),
    "noisy": Scene(
        Rig(Layout.RING, 5, (4.5, 4.5), 2.3),
        Cast(4, (4.0, 4.0), gestures=_ACTIVE),
        detector=DetectorAccuracy(
            noise_m=0.025,
            tail=3.0,
            faults=Faults(
                miss_joint=0.08, miss_body=0.12, swap=0.06, mix=0.15, duplicate=0.05, false_positives=0.2, memory_s=0.2
            ),
        ),
    ),
    "comings-and-goings": Scene(
        Rig(Layout.RING, 6, (5.5, 5.0), 2.6),
        Cast(6, (5.0, 4.0), walking=0.7, doors_m=((-4.5, -3.0), (4.5, 3.0), (0.0, 4.2))),
        duration_s=60.0,
    ),
}
"""Scenes of ``simulate`` by name."""


def find_scene(name: str) -> Scene:
    """Look up a scene by name. Raises ``InputError`` if the name is unknown."""
    if name not in SCENES:
        problem = Problem(UNKNOWN_SCENE, f"There is no scene {name!r}.", hint=f"Known are {', '.join(SCENES)}.")
        raise InputError([problem])
    return SCENES[name]


def known_joints(name: str) -> Joints:
    """Look up a choice of joints by name. Raises ``InputError`` if the name is unknown."""
    for joints in get_args(Joints):
        if joints == name:
            return cast(Joints, joints)
    problem = Problem(
        UNKNOWN_JOINTS,
        f"There are no joints {name!r}.",
        field="joints",
        hint=f"Known are {', '.join(get_args(Joints))}.",
    )
    raise InputError([problem])


def simulate(scene_name: str, seed: int, num_views: int | None = None, joints: Joints = "body") -> Simulation:
    """Simulate a named scene.

    ``seed``: seed, 0 or greater; the same seed gives the same bytes. ``num_views``: number of the scene's cameras to
    keep, evenly spread; ``None`` for all. A camera's recording does not depend on the other cameras. ``joints``: joints
    of the detections and of the truth. The body's joints differ between the choices only in the knees and ankles of
    rolling feet. Raises ``InputError`` if the scene is unknown or has fewer cameras, or the seed is negative.
    """
    return record(find_scene(scene_name), seed, num_views, joints)


def _act(
    scene: Scene, cast_seed: np.random.SeedSequence, people_seed: np.random.SeedSequence, joints: JointSet
) -> list[tuple[JointsAt, SegmentsAt]]:
    """Positions of each person's joints, and orientations of the segments, as functions of time."""
    if callable(scene.cast):
        return scene.cast(scene.duration_s, people_seed, joints)
    roles = _roles(scene.cast, scene, np.random.default_rng(cast_seed))
    people = (
        perform(role, scene.duration_s, np.random.default_rng(person_seed), joints)
        for role, person_seed in zip(roles, people_seed.spawn(len(roles)), strict=True)
    )
    return [(partial(joints_at, person), partial(segments_at, person)) for person in people]


def _roles(cast: Cast | PlaceExchange | tuple[Role, ...], scene: Scene, rng: np.random.Generator) -> tuple[Role, ...]:
    match cast:
        case Cast():
            return improvise(cast, scene.boxes, scene.duration_s, rng)
        case PlaceExchange():
            return exchange(cast, scene.duration_s, rng)
        case _:
            return cast


def record(scene: Scene, seed: int, num_views: int | None = None, joints: Joints = "body") -> Simulation:
    """Simulate a scene; see ``simulate``."""
    num_cameras = scene.rig.num_cameras
    num_views = num_cameras if num_views is None else num_views
    problems = []
    if not 1 <= num_views <= num_cameras:
        message = f"There are {num_cameras} cameras, not {num_views}."
        problems.append(Problem(WRONG_NUMBER_OF_VIEWS, message, field="views", hint="Ask for 1 to all of them."))
    if seed < 0:
        problems.append(Problem(NEGATIVE_SEED, "A seed can't be negative.", field="seed"))
    if problems:
        raise InputError(problems)

    # Separate random streams for the cast, each person, the rig and each camera: none depends on draws of another.
    cast_seed, people_seed, rig_seed, cameras_seed = np.random.SeedSequence(seed).spawn(4)
    joint_set = JOINT_SETS[joints]
    people = _act(scene, cast_seed, people_seed, joint_set)

    def truth_at(time_s: Float[np.ndarray, " times"]) -> Float[np.ndarray, "people times joints 3"]:
        return np.stack([joints_of_person_at(time_s) for joints_of_person_at, _ in people])

    cameras = build_cameras(scene.rig, np.random.default_rng(rig_seed))
    streams = [np.random.default_rng(camera_seed) for camera_seed in cameras_seed.spawn(num_cameras)]
    chosen = choose_views(num_cameras, num_views)
    times: dict[str, FrameTimes] = {}
    detections: dict[str, Detections] = {}
    identities: dict[str, np.ndarray] = {}
    sketches: list[Sketch] = []
    for number in chosen:
        camera, rng = cameras[number], streams[number]
        times[camera.name] = frame_times(scene.clock, number, scene.duration_s, rng)
        time_s = times[camera.name].time_s
        period_s = float(np.median(np.diff(time_s)))
        people_m = truth_at(time_s)
        body = camera, period_s, people_m[:, :, : len(COCO_17.names)], scene.boxes, scene.detector, rng
        if joints == "body":
            detections[camera.name], identities[camera.name] = detect(*body)
        else:
            whole = camera, period_s, people_m, scene.boxes, scene.detector, rng, joint_set
            detections[camera.name], identities[camera.name] = detect_extremities(*whole)
        sketches.append(sketch(*body))
    rate_hz = scene.clock.frame_rate_hz
    timebase = Timebase(0.0, rate_hz, round(scene.duration_s * rate_hz))
    frame_s = np.arange(timebase.num_frames) / rate_hz
    truth_m = truth_at(frame_s)
    truth_deg = np.degrees([segment_angles(segments_of_person_at(frame_s)) for _, segments_of_person_at in people])
    return Simulation(
        cameras=tuple(cameras[number] for number in chosen),
        times=times,
        detections=detections,
        identities=identities,
        joints=joint_set,
        timebase=timebase,
        truth_m=read_only(truth_m),
        truth_deg=read_only(truth_deg),
        present=read_only(np.isfinite(truth_m).all((2, 3))),
        sketches=tuple(sketches),
    )


def simulation_files(simulation: Simulation) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the contents of each file; equal simulations give equal bytes.

    Keypoints are COCO-17 for the body alone, otherwise BODY_25 with hands of 21 points, wrist first.
    """
    yield "calibration.json", encode(simulation.cameras)
    yield "timestamps.csv", _timestamps(simulation)
    for camera in simulation.cameras:
        num_frames = len(simulation.times[camera.name].time_s)
        for frame, content in enumerate(_frames(simulation.detections[camera.name], num_frames, simulation.joints)):
            yield f"keypoints/{camera.name}/frame_{frame:012d}_keypoints.json", content
    yield "truth.npz", _truth(simulation)


def _timestamps(simulation: Simulation) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("camera", "frame", "time_s"))
    for camera, times in simulation.times.items():
        rows.writerows((camera, frame, repr(time_s)) for frame, time_s in enumerate(times.time_s.tolist()))
    return text.getvalue().encode()


def _frames(detections: Detections, num_frames: int, joints: JointSet) -> Iterator[bytes]:
    borders = np.searchsorted(detections.frame, np.arange(num_frames + 1)).tolist()
    for first, last in itertools.pairwise(borders):
        yield encode_frame(detections.keypoints_px[first:last], detections.score[first:last], joints)


def _truth(simulation: Simulation) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(
        file,
        xyz_m=simulation.truth_m,
        joint_names=np.array(simulation.joints.names),
        angle_deg=simulation.truth_deg,
        angle_names=np.array(ANGLE_NAMES),
        frame_rate_hz=np.array(simulation.timebase.frame_rate_hz),
        start_time_s=np.array(simulation.timebase.start_time_s),
    )
    return file.getvalue()
