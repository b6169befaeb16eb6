"""First people of a job: they stand where the simulated people stand, each with one id."""

import json

import numpy as np

from pipeline.run.engine.first_people import RATE_HZ, first_people
from pipeline.validation.simulation.scenes import find_scene, record


def test_first_people_stand_where_people_are() -> None:
    simulation = record(find_scene("room"), seed=4, num_views=4)
    cameras, timebase, frames = simulation.cameras, simulation.timebase, range(20, 70)
    found = json.loads(
        first_people(cameras, simulation.times, timebase, simulation.detections, simulation.joints, frames)
    )
    rate_hz = timebase.frame_rate_hz
    assert len(found["instants"]) == int(len(frames) / rate_hz * RATE_HZ)
    assert [camera["name"] for camera in found["rig"]] == [camera.name for camera in cameras]
    errors_m, ids = [], set()
    for instant in found["instants"]:
        frame = round((instant["time_s"] - timebase.time_s(0)) * rate_hz)
        for person in instant["people"]:
            ids.add(person["id"])
            joints_m = np.array(person["joints_m"], float).reshape(-1, 3)
            true_m = simulation.truth_m[:, frame]
            errors_m.append(min(np.nanmedian(np.linalg.norm(joints_m - one, axis=-1)) for one in true_m))
    assert errors_m
    assert np.median(errors_m) < 0.05
    assert len(ids) == simulation.truth_m.shape[0]
