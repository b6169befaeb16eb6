"""Sightings of simulations, and rigs with faults."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.data.cameras import Camera
from pipeline.data.rigid import Rigid3
from pipeline.preflight.sightings import SimultaneousPeople, choose_instants, frames_at, sightings_of
from pipeline.simulation.scenes import Simulation


def sightings(simulation: Simulation) -> SimultaneousPeople:
    """People of a simulation at twelve instants."""
    instants = choose_instants([range(simulation.timebase.num_frames)])
    frames = {name: frames_at(times, simulation.timebase, instants) for name, times in simulation.times.items()}
    return sightings_of(simulation.cameras, simulation.detections, frames, simulation.joints)


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
