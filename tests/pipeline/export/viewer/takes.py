"""Takes of walkers, and a plain reader of what viewers read."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.people import Doubt, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.viewer.description import Footage
from pipeline.motion.forces.person_forces import PersonForces
from pipeline.motion.skeleton.animate import animate
from tests.pipeline.export.quality.test_report import CAMERAS, RATE_HZ, observe
from tests.pipeline.motion.forces.physical_people import estimated, solved
from tests.pipeline.motion.gait.walks import walk

FOOTAGE = {
    camera.name: Footage(
        FrameTimes(0.25 + np.arange(100) / RATE_HZ), f"{camera.name}.mp4", FrameTimes(np.arange(100) / RATE_HZ)
    )
    for camera in CAMERAS
}


def take(*tracks: Track3D, doubts: Sequence[Sequence[Doubt]] = (), num_frames: int = 100) -> Reconstruction:
    timebase = Timebase(0.25, RATE_HZ, num_frames)
    observations = tuple(observe(track) for track in tracks)
    animation = animate(tracks, observations, CAMERAS, timebase, COCO_17, ReconstructionConfig(smoothing="none"))
    return Reconstruction(CAMERAS, COCO_17, timebase, tracks, observations, animation, doubts=doubts)


def read_record(description: dict[str, Any], content: bytes, person: int, row: int) -> dict[str, Any]:
    """Read a record by what ``motion.json`` says, with nothing but ``struct``."""
    record, about = description["record"], description["people"][person]
    start = about["offset_bytes"] + row * record["num_bytes"]
    num_joints, num_bones = len(description["joint_names"]), len(description["skeleton"]["names"])

    def values(name: str, form: str) -> tuple[Any, ...]:
        return struct.unpack_from(f"<{form}", content, start + record["offsets"][name])

    origin_m = np.array(values("origin_m", "3f"))

    def positions_m(name: str, number: int) -> np.ndarray:
        steps = np.array(values(name, f"{3 * number}h"), float).reshape(number, 3)
        steps[steps == record["absent"]] = np.nan
        return origin_m + steps * about["position_step_m"]

    source_views = values("source_views", f"{num_joints}B")
    return {
        "joints_m": positions_m("joints", num_joints),
        "skeleton_m": positions_m("skeleton", num_bones),
        "angle_deg": [
            np.nan if step == record["absent"] else step * record["angle_step_deg"]
            for step in values("angles", f"{len(description['angle_names'])}h")
        ],
        "source": [value & 3 for value in source_views],
        "views": [value >> 2 for value in source_views],
        "score": [value / 255 for value in values("score", f"{num_joints}B")],
        "error": values("error", f"{num_joints}B"),
        "camera_error": values("camera_error", f"{len(description['cameras'])}B"),
        "identity": values("identity", "B")[0] / 255,
    }


def walk_with_forces() -> tuple[Reconstruction, PersonForces]:
    """Two simulated people who walk in step, and the forces of the first."""
    act = walk(1.2)
    animation = solved(act)
    (track,), (motion,) = animation.tracks, animation.motions
    aside_m = np.array([0.0, 1.2, 0.0])
    tracks = track, replace(track, track_id=2, xyz_m=track.xyz_m + aside_m)
    motions = motion, replace(motion, track_id=2, name="person-2", root_m=motion.root_m + aside_m)
    timebase = Timebase(0.0, act.rate_hz, track.num_frames)
    people = Animation(tracks, motions, animation.floor)
    observations = tuple(observe(track) for track in tracks)
    return Reconstruction(CAMERAS, act.joints, timebase, tracks, observations, people), estimated(act)
