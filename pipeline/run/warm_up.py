"""Program ``python -m pipeline.run.warm_up``: compile all kernels, so that no request waits for it.

The program does nothing if all kernels are compiled. With ``--progress`` it writes a JSON object with ``done`` and
``total`` to stdout after each compiled function.
"""

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numba.core import event

from pipeline.association.hands.attach import attach_hands, has_hands, without_fingers
from pipeline.association.identity.sides import decide_sides
from pipeline.association.tracking.observations import gather
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.capture.synchronization.motions import find_motions
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import ModelError
from pipeline.core.joints import COCO_17, SIDES, WHOLE_BODY, JointSet, finger_joints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.kernel_cache import cache_folder, is_complete, note_complete
from pipeline.core.runtime.packages.storage import exclusive
from pipeline.geometry.camera import project
from pipeline.geometry.fields import connectivity
from pipeline.motion.skeleton.animate import animate

_NUM_FRAMES = 10
_RATE_HZ = 25.0

JOINT_SETS = (COCO_17, WHOLE_BODY)
"""A joint set of each padded size. Fingers are not tracked: the size of ``WHOLE_BODY`` is that with heels and toes."""

# Functions of Multicap that the warm-up compiles, each counted for every size of joint set that it is called with.
NUM_COMPILED = 109
# Multicap's functions are in packages under this one: `pipeline.`, or `multicap.pipeline.` in the wheel.
_OWN_MODULES = f"{__package__.removesuffix('.run')}."


def warm_up(joint_sets: Sequence[JointSet] = JOINT_SETS) -> None:
    """Compile kernels, or load compiled ones: track and fit a person with each joint set, and read a field.

    By default these are all kernels.
    """
    for joints in joint_sets:
        _reconstruct_person(joints)
    ends = np.array([[0.0, 0.0], [1.0, 1.0]])
    connectivity(read_only(np.full((1, 2, 2, 2), 255, np.uint8)), np.zeros(1, int), ends[:1], ends[1:])


def _reconstruct_person(joints: JointSet) -> None:
    """Track and fit a person who stands in front of three cameras."""
    num_joints = len(joints.names)
    random = np.random.default_rng(0)
    body_m = random.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (num_joints, 3))
    if has_hands(joints):
        for side in SIDES:
            fingers = finger_joints(side)
            place_m = random.uniform(-0.05, 0.05, (len(fingers), 3))
            body_m[joints.indices(fingers)] = body_m[joints.index(f"{side}_wrist")] + place_m
    cameras = [_camera(number) for number in range(3)]
    points_px = {camera.name: np.repeat(project(camera, body_m)[None], _NUM_FRAMES, axis=0) for camera in cameras}
    detections = {
        camera.name: Detections(
            camera=camera.name,
            frame=np.arange(_NUM_FRAMES),
            keypoints_px=read_only(points_px[camera.name]),
            score=read_only(np.ones((_NUM_FRAMES, num_joints))),
            box_px=np.zeros((_NUM_FRAMES, 4)),
        )
        for camera in cameras
    }
    times = {camera.name: FrameTimes(np.arange(_NUM_FRAMES) / _RATE_HZ) for camera in cameras}
    timebase = Timebase(0.0, _RATE_HZ, _NUM_FRAMES)
    bodies, parameters = gather(cameras, times, detections), derive_parameters(cameras, _RATE_HZ)
    people = track_bodies(cameras, times, without_fingers(bodies, joints), timebase, parameters)
    if has_hands(joints):
        people = attach_hands(people, bodies, cameras, joints, timebase, parameters.min_score, parameters.lambda_t_hz)
    find_motions(cameras, times, detections, joints)
    for person in zip(people.tracks, people.observations, strict=True):
        decide_sides(person, cameras, timebase, joints, parameters.min_score)
    animate(people.tracks, people.observations, cameras, timebase, joints, ReconstructionConfig())


def _camera(number: int) -> Camera:
    """Make a camera 4 m from the origin and 1 m above the floor."""
    cos, sin = np.cos(number), np.sin(number)
    rotation = np.array([[-sin, cos, 0.0], [0.0, 0.0, -1.0], [-cos, -sin, 0.0]])
    matrix = np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 359.5], [0.0, 0.0, 1.0]])
    translation_m = np.array([0.0, 1.0, 4.0])
    return Camera(f"cam{number}", (1280, 720), matrix, np.array([-0.1, 0.0, 0.0, 0.0]), Rigid3(rotation, translation_m))


@contextlib.contextmanager
def _counted(on_compiled: Callable[[int], None]) -> Iterator[None]:
    """Call ``on_compiled`` with the number of compiled functions of Multicap after each of them is compiled."""
    listener = _Counter(on_compiled)
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)  # type: ignore[no-untyped-call]


class _Counter(event.Listener):
    def __init__(self, on_compiled: Callable[[int], None]) -> None:
        self._on_compiled, self._done = on_compiled, 0

    def on_start(self, event: event.Event) -> None:
        """Ignore the start of a compilation."""

    def on_end(self, event: event.Event) -> None:
        """Count a compiled function of Multicap; functions of numba are not counted."""
        if event.data["dispatcher"].py_func.__module__.startswith(_OWN_MODULES):
            self._done += 1
            self._on_compiled(self._done)


def main() -> None:
    """Compile all kernels that are not compiled; wait if another process compiles them."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.run.warm_up", description="Compile the numeric kernels.")
    parser.add_argument("--progress", action="store_true", help="Write the progress as a JSON object a line.")
    tell = _tell if parser.parse_args().progress else lambda _: None
    folder = cache_folder()
    if folder is None:
        sys.stderr.write("warning: Compiled kernels can't be kept: the folder MULTICAP_HOME can't be written.\n")
        return
    if is_complete():
        return
    tell(0)
    try:
        with exclusive(folder), _counted(tell):
            if not is_complete():
                warm_up()
                note_complete()
    except (ModelError, OSError) as error:
        sys.exit(f"error: The numeric kernels can't be compiled into {folder}: {error}")


def _tell(done: int) -> None:
    sys.stdout.write(json.dumps({"done": done, "total": NUM_COMPILED}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
