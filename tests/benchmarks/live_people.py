"""Benchmark `live-people`: feet that stand, and numbers of people who come back, against the truth."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import typer
from jaxtyping import Bool, Float

from api.cli.console import JsonOption, emit, print_table, reporting
from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.detections import Detections
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.skeleton.animate import animate
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import DetectedFrame, LiveInstant, detected_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.run.warm_up import warm_up
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.clothes import dress

ROOM = SCENES["room"]
# Scenes in which people stand and walk, and their length.
_FEET_SCENES, _FEET_S = ("room", "walk", "noisy"), 15.0
# Skeletons of the live capture are there by now.
_SETTLED_S = 4.0
# True speed below which a joint of a foot stands.
_STANDING_M_S = 0.02
_FOOT_JOINTS = ("ankle", "heel", "big_toe")
# People stay, are away, and stay again; then they are to have their numbers, and strangers are not.
_STAY_S, _AWAY_S, _AGAIN_S = 16.0, 5.0, 6.0
_NUM_SEEDS, _NUM_PEOPLE = 4, 3

Bodies = Mapping[int, Float[np.ndarray, "joints 3"]]
"""Joints of people by their numbers, world positions in metres."""


@dataclass(slots=True, eq=False)
class StandingJoints:
    """Speeds and errors of joints that stand in truth; ``joints`` are their places among the detector's."""

    joints: list[int]
    speed_m_s: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)

    def add(self, simulation: Simulation, instants: Iterable[tuple[int, Bodies]]) -> None:
        """Take the people of frames that follow each other; each counts as the nearest true one."""
        rate_hz = simulation.timebase.frame_rate_hz
        before: Bodies = {}
        for frame, bodies in instants:
            for number in before.keys() & bodies.keys() if frame >= _SETTLED_S * rate_hz else ():
                apart_m = np.linalg.norm(simulation.truth_m[:, frame] - bodies[number], axis=-1)
                person = int(np.nanargmin(np.nanmean(apart_m, axis=-1)))
                truth_m = simulation.truth_m[person, frame - 1 : frame + 1, self.joints]
                stands = np.linalg.norm(truth_m[:, 1] - truth_m[:, 0], axis=-1) * rate_hz < _STANDING_M_S
                moved_m = np.linalg.norm(bodies[number][self.joints] - before[number][self.joints], axis=-1)
                known = stands & np.isfinite(moved_m)
                self.speed_m_s += (moved_m * rate_hz)[known].tolist()
                self.error_m += apart_m[person, self.joints][known].tolist()
            before = bodies

    def figures(self) -> dict[str, float]:
        """Mean speed and error."""
        return {"slide_cm_s": 1e2 * float(np.mean(self.speed_m_s)), "error_mm": 1e3 * float(np.mean(self.error_m))}


def measure_all_feet() -> list[dict[str, Any]]:
    """``measure_feet`` in scenes in which people stand and walk."""
    return [row for scene in _FEET_SCENES for row in measure_feet(scene)]


def measure_feet(scene: str, duration_s: float = _FEET_S, seed: int = 1) -> Iterator[dict[str, Any]]:
    """Slide and error of each joint of a foot while it stands: of live skeletons and of the finished fit."""
    simulation = record(replace(SCENES[scene], duration_s=duration_s), seed, joints="feet")
    timebase, cameras, joints = simulation.timebase, simulation.cameras, simulation.joints
    frames = detected_frames(cameras, simulation.times, simulation.detections)
    live = list(enumerate(map(_live_bodies, _played(simulation, frames))))
    parameters = derive_parameters(cameras, timebase.frame_rate_hz)
    people = reconstruct_tracks(cameras, simulation.times, simulation.detections, timebase, parameters)
    tracks = animate(*people, cameras, timebase, joints, ReconstructionConfig()).tracks
    fit = [
        (frame, {track.track_id: track.xyz_m[frame - track.start_frame] for track in tracks if frame in track.frames})
        for frame in range(timebase.num_frames)
    ]
    for joint in _FOOT_JOINTS:
        places = joints.indices((f"left_{joint}", f"right_{joint}"))
        figures: dict[str, Any] = {"scene": scene, "joint": joint}
        for prefix, instants in (("", live), ("fit_", fit)):
            standing = StandingJoints(places)
            standing.add(simulation, instants)
            figures |= {f"{prefix}{name}": value for name, value in standing.figures().items()}
        yield figures


def _live_bodies(instant: LiveInstant) -> Bodies:
    return {person.id: person.xyz_m for person in instant.people if person.skeleton is not None}


def _played(simulation: Simulation, frames: Iterable[DetectedFrame]) -> list[LiveInstant]:
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(simulation.timebase.frame_rate_hz))
    return [instant for frame in frames for instant in capture.push(*frame)] + capture.flush()


def measure_returns(num_seeds: int = _NUM_SEEDS, *, have_clothes: bool) -> dict[str, Any]:
    """Numbers of people who come back after seconds, and of strangers who come in their place.

    Each seed has a room with six people. Three of them are there for 16 s; then, in one capture, they come back after
    5 s, and in another one the three others come. With clothes each of the six wears others.
    """
    figures: dict[str, Any] = {"people": 0, "back": 0, "mistaken": 0, "strangers": 0, "strangers_mistaken": 0}
    after_s: list[float] = []
    for seed in range(num_seeds):
        cast = Cast(2 * _NUM_PEOPLE, (4.0, 4.0), gestures=ROOM.cast.gestures if isinstance(ROOM.cast, Cast) else ())
        simulation = record(replace(ROOM, cast=cast, duration_s=_STAY_S + _AGAIN_S), seed)
        if have_clothes:
            simulation = dress(simulation, lambda person, time_s: person)
        first, others = np.arange(2 * _NUM_PEOPLE) < _NUM_PEOPLE, np.arange(2 * _NUM_PEOPLE) >= _NUM_PEOPLE
        for comers in (first, others):
            known, instants = _track_numbers(simulation, first, comers)
            last = instants[-1][1]
            if comers is others:
                figures["strangers"] += len(last)
                figures["strangers_mistaken"] += sum(number in known.values() for number in last.values())
                continue
            figures["people"] += len(last)
            for person, number in last.items():
                is_back = number == known.get(person)
                figures["back"] += is_back
                figures["mistaken"] += not is_back and number in known.values()
                if is_back:
                    others_s = [time_s for time_s, numbers in instants if numbers.get(person, number) != number]
                    after_s.append(max(others_s, default=0.0))
    return {**figures, "back_after_s": float(np.median(after_s)) if after_s else None}


def _track_numbers(
    simulation: Simulation, first: Bool[np.ndarray, " people"], comers: Bool[np.ndarray, " people"]
) -> tuple[dict[int, int], list[tuple[float, dict[int, int]]]]:
    """Track numbers by true person: before the break, and at each instant after it with its time since the break."""
    shown = np.array([first, comers])
    detections = {name: _seen(simulation, name, shown) for name in simulation.detections}
    frames = [
        frame if frame.time_s < _STAY_S else frame._replace(time_s=frame.time_s + _AWAY_S)
        for frame in detected_frames(simulation.cameras, simulation.times, detections)
    ]
    known: dict[int, int] = {}
    behind: list[tuple[float, dict[int, int]]] = []
    for instant in _played(simulation, frames):
        since_s = instant.time_s - _STAY_S - _AWAY_S
        if since_s < -_AWAY_S:
            known = _by_person(simulation, instant, instant.time_s, first)
        elif since_s >= 0.0:
            behind.append((since_s, _by_person(simulation, instant, instant.time_s - _AWAY_S, comers)))
    return known, behind


def _seen(simulation: Simulation, name: str, shown: Bool[np.ndarray, "2 people"]) -> Detections:
    """Detections of the people who are there before the break and behind it."""
    detections, person = simulation.detections[name], simulation.identities[name]
    is_behind = simulation.times[name].time_s[detections.frame] >= _STAY_S
    kept = (person < 0) | shown[is_behind.astype(int), person]  # false positives stay
    return replace(
        detections,
        frame=detections.frame[kept],
        keypoints_px=detections.keypoints_px[kept],
        score=detections.score[kept],
        box_px=detections.box_px[kept],
        colour=detections.colour[kept] if len(detections.colour) else detections.colour,
    )


def _by_person(
    simulation: Simulation, instant: LiveInstant, time_s: float, there: Bool[np.ndarray, " people"]
) -> dict[int, int]:
    """Number of the live person by the nearest true person."""
    frame = min(round(time_s * simulation.timebase.frame_rate_hz), simulation.timebase.num_frames - 1)
    truth_m = np.where(there[:, None, None], simulation.truth_m[:, frame], np.inf)
    return {
        int(np.argmin(np.nanmean(np.linalg.norm(truth_m - person.xyz_m, axis=-1), axis=-1))): person.id
        for person in instant.people
    }


def live_people(as_json: JsonOption = False) -> None:
    """Measure feet that stand, and the numbers of people who come back."""
    with reporting(as_json):
        warm_up()
        feet = measure_all_feet()
        returns = {kind: measure_returns(have_clothes=kind == "clothes") for kind in ("keypoints", "clothes")}
    if as_json:
        emit({"feet": feet, "returns": returns})
        return
    columns = [name.replace("_", " ") for name in feet[0]]
    rows = ([value if isinstance(value, str) else f"{value:.1f}" for value in row.values()] for row in feet)
    print_table(columns, rows, "Joints of feet that stand, live and of the finished fit")
    for kind, figures in returns.items():
        typer.echo(
            f"With {kind}, {figures['back']} of {figures['people']} people who came back got their numbers again, half "
            f"of them within {figures['back_after_s']:.1f} s; {figures['mistaken']} got numbers of others. "
            f"{figures['strangers_mistaken']} of {figures['strangers']} strangers got the number of a person who had "
            "left."
        )
