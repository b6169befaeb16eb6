"""Live identities are those of the finished session."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.association.tracking.kernels.state import Frames
from pipeline.association.tracking.observations import UNASSIGNED, gather, undistorted
from pipeline.association.tracking.tracker import Tracker, TrackerState, make_frames
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera
from pipeline.run.live import tracking
from pipeline.run.live.frames import make_frame
from pipeline.run.live.tracking import LiveTracker
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.conftest import body, detections_of
from tests.pipeline.run.live.streams import sent_frames

LAWFUL = settings(max_examples=6, deadline=None)


def simulate(scene: str, seed: int) -> Simulation:
    return record(replace(SCENES[scene], duration_s=2.5), seed)


def frames_of(simulation: Simulation) -> Frames:
    bodies = gather(simulation.cameras, simulation.times, simulation.detections)
    times = [simulation.times[camera.name] for camera in simulation.cameras]
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    return make_frames(times, bodies, undistorted(simulation.cameras, bodies), parameters.min_score)


def identities_in_pieces(simulation: Simulation, frames: Frames, lengths: list[int]) -> np.ndarray:
    """Identities when the tracker gets pieces of the frames; each piece has the detections of its frames alone."""
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    state = TrackerState(simulation.cameras, frames.score.shape[1], parameters, most_detections=1)
    identity, carried, start, number = np.full(len(frames.score), UNASSIGNED), np.empty(0, int), 0, 0
    while start < len(frames.time_s):
        piece = slice(start, start + lengths[number % len(lengths)])
        counts = frames.last[piece] - frames.first[piece]
        new = [np.arange(a, b) for a, b in zip(frames.first[piece], frames.last[piece], strict=True)]
        rows = np.concatenate([carried, *new])
        first = len(carried) + np.cumsum(counts) - counts
        points_px, of_piece = frames.points_px[rows], identity[rows]
        state.advance(
            Frames(
                frames.time_s[piece].copy(), frames.camera[piece].copy(), first, first + counts, points_px,
                frames.score[rows], points_px.reshape(len(rows), 2 * points_px.shape[1]),
            ),
            of_piece,
        )  # fmt: skip
        identity[rows] = of_piece
        carried, start, number = rows[state.carry()], piece.stop, number + 1
    return np.append(state.final_identities(), UNASSIGNED)[identity]


@LAWFUL
@given(
    scene=st.sampled_from(["room", "noisy", "comings-and-goings", "unsynchronised"]),
    seed=st.integers(0, 50),
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=5),
)
def test_identities_do_not_depend_on_how_frames_come(scene: str, seed: int, lengths: list[int]) -> None:
    """One frame, or many at a time: the same as of all frames at once, also of targets that are confirmed later."""
    simulation = simulate(scene, seed)
    frames = frames_of(simulation)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    whole = Tracker(simulation.cameras, frames, parameters).run()
    np.testing.assert_array_equal(identities_in_pieces(simulation, frames, [1]), whole)
    np.testing.assert_array_equal(identities_in_pieces(simulation, frames, lengths), whole)


def live_numbers(simulation: Simulation, frames: Frames) -> np.ndarray:
    """Person of each detection as known when its frame was processed."""
    rate_hz = simulation.timebase.frame_rate_hz
    parameters = derive_parameters(simulation.cameras, rate_hz)
    tracker = LiveTracker(simulation.cameras, len(simulation.joints.names), parameters, rate_hz)
    number = np.full(len(frames.score), UNASSIGNED)
    for frame, first, last in zip(sent_frames(simulation), frames.first, frames.last, strict=True):
        sent = make_frame(simulation.cameras[frame.camera], *frame)
        number[first:last] = tracker.advance([sent])
    return number


@LAWFUL
@given(
    scene=st.sampled_from(["room", "noisy", "comings-and-goings"]),
    seed=st.integers(0, 50),
    most=st.sampled_from([0, 1024]),
)
def test_confirmed_people_are_those_of_finished_session(scene: str, seed: int, most: int) -> None:
    """A person has one number live; targets that ended are forgotten at once, or never."""
    simulation = simulate(scene, seed)
    frames = frames_of(simulation)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    whole = Tracker(simulation.cameras, frames, parameters).run()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracking, "_MOST_NUMBERED", most)
        number = live_numbers(simulation, frames)
    is_known = number != UNASSIGNED
    pairs = np.unique(np.stack([number[is_known], whole[is_known]]), axis=1)
    assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]
    assert UNASSIGNED not in pairs[1]
    # Left open live are detections before the third instant of a person, and of targets without one.
    assert scene != "room" or is_known.sum() > 0.9 * (whole != UNASSIGNED).sum() - 60
    assert not (is_known & (whole == UNASSIGNED)).any()


def test_people_who_come_and_go_leave_nothing_behind(ring: tuple[Camera, ...]) -> None:
    """A new person every second, and noise in every frame: what is kept stays the same."""
    rate_hz, rng = 25.0, np.random.default_rng(3)
    tracker = LiveTracker(ring, 17, derive_parameters(ring, rate_hz), rate_hz)
    kept, numbers = [], set()
    for frame in range(750):
        person_m = body() + np.array([1.5 * np.sin(frame // 25), 1.5 * np.cos(frame // 25), 0.0])
        for number, camera in enumerate(ring):
            points_px = detections_of(camera, person_m[None, None]).keypoints_px
            noise_px = points_px[0].mean(0) + rng.normal(0.0, 200.0, (1, 17, 2))
            sent = make_frame(camera, number, frame / rate_hz, np.concatenate([points_px, noise_px]), np.ones((2, 17)))
            numbers |= set(tracker.advance([sent]).tolist())
        kept.append(tracker.num_kept())
    assert len(numbers) > 20
    assert max(kept[250:]) <= max(kept[:250]) + 2
    assert max(kept) < 40
