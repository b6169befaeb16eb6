"""Sightings of simulations and of posed people, and rigs with faults."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import project
from pipeline.run.session_check.sightings import SimultaneousPeople, choose_instants, collect_sightings, frames_at
from pipeline.validation.simulation.scenes import Simulation


def sightings(simulation: Simulation) -> SimultaneousPeople:
    """People of a simulation at twelve instants."""
    instants = choose_instants([range(simulation.timebase.num_frames)])
    frames = {name: frames_at(times, simulation.timebase, instants) for name, times in simulation.times.items()}
    time_s = [simulation.timebase.time_s(instant) for instant in instants]
    return collect_sightings(simulation.cameras, simulation.detections, frames, simulation.joints, time_s)


def bumped(camera: Camera, degrees: float) -> Camera:
    """Camera that was panned about its centre."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(turn @ pose.rotation, turn @ pose.translation_m))


def in_other_world(camera: Camera, turn: Rotation | None = None, scale: float = 1.0, lift_m: float = 0.0) -> Camera:
    """Camera in a world that is turned, scaled, or lifted along Z."""
    pose = camera.cam_from_world
    rotation = pose.rotation if turn is None else pose.rotation @ turn.as_matrix().T
    lift = rotation @ np.array([0.0, 0.0, lift_m])
    return replace(camera, cam_from_world=Rigid3(rotation, scale * pose.translation_m - lift))


def posed(
    simulation: Simulation, turn: Rotation, scale: float = 1.0, height_m: float = 0.3
) -> Float[np.ndarray, "instants people joints 3"]:
    """People of a simulation at twelve instants, turned about their hips, with the hips at a height."""
    instants = choose_instants([range(simulation.timebase.num_frames)])
    people_m = simulation.truth_m[:, instants].swapaxes(0, 1)
    hips = [simulation.joints.names.index(name) for name in ("left_hip", "right_hip")]
    middle_m = people_m[:, :, hips].mean(2, keepdims=True)
    place_m = np.concatenate([middle_m[..., :2], np.full_like(middle_m[..., 2:], height_m)], axis=-1)
    return np.asarray(scale * (people_m - middle_m) @ turn.as_matrix().T + place_m)


def seen_by(
    cameras: Sequence[Camera],
    people_m: Sequence[Float[np.ndarray, "instants people joints 3"]],
    joints: JointSet,
    noise_px: float = 2.0,
    step_s: float = 0.5,
) -> SimultaneousPeople:
    """Sightings of people, those of each camera, with noise, at instants that are a step apart."""
    rng = np.random.default_rng(11)
    return SimultaneousPeople(
        tuple(
            tuple(
                project(camera, instant_m) + rng.normal(0.0, noise_px, (*instant_m.shape[:2], 2)) for instant_m in own_m
            )
            for camera, own_m in zip(cameras, people_m, strict=True)
        ),
        joints,
        tuple(step_s * instant for instant in range(len(people_m[0]))),
    )
