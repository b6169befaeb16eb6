"""Planted faults of a capture, put right by edits that later runs keep: by another method, profile and format."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.people import People
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import other_side
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edited_take import apply_edits, place_edits
from pipeline.core.options.edits import (
    Exchange,
    ExchangeSides,
    IgnoreDetections,
    KeyJoint,
    PeopleEdit,
    edit_document,
    read_edit,
)
from pipeline.core.options.file_formats import Export
from pipeline.export.results import write_results
from pipeline.geometry.camera import project
from pipeline.run.engine.local import reconstruct
from pipeline.run.engine.methods import Association
from pipeline.run.engine.stored_people import StoredPeople, write_people
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

SIMULATION = record(replace(find_scene("room"), duration_s=4.0), seed=6)
RATE_HZ = SIMULATION.timebase.frame_rate_hz
PLAIN = ReconstructionConfig()
PERSON = 0  # in the truth; there in all frames
LATER = [replace(PLAIN, method="clustering"), replace(PLAIN, profile="fast", smoothing="none")]
CUT = 50  # frame from which on identities are exchanged
TURNED = range(40, 52)  # frames in which sides are exchanged
OTHERS = [SIMULATION.joints.index(name if name == "nose" else other_side(name)) for name in SIMULATION.joints.names]

Change = Callable[[str, np.ndarray, np.ndarray, np.ndarray], None]
"""Change of the person's detections by camera, in place: joints in pixels, scores, times."""


def column(joint: str) -> int:
    return SIMULATION.joints.index(joint)


def within(time_s: np.ndarray, frames: range) -> np.ndarray:
    """True if times are of output frames."""
    return np.isin(np.round(time_s * RATE_HZ), frames)


def exchange_sides(camera: str, points_px: np.ndarray, score: np.ndarray, time_s: np.ndarray) -> None:
    rows = np.flatnonzero(within(time_s, TURNED))
    points_px[rows], score[rows] = points_px[rows][:, OTHERS], score[rows][:, OTHERS]


def move_elbow(camera: str, points_px: np.ndarray, score: np.ndarray, time_s: np.ndarray) -> None:
    """Two cameras see the elbow 15 cm off in eight frames, and the others do not see it."""
    elbow, number = column("left_elbow"), [one.name for one in SIMULATION.cameras].index(camera)
    rows = np.flatnonzero(within(time_s, range(40, 48)))
    points_px[rows, elbow], score[rows, elbow] = np.nan, 0.0
    if number < 2:
        frames = np.arange(SIMULATION.timebase.num_frames) / RATE_HZ
        truth_m = SIMULATION.truth_m[PERSON, :, elbow]
        at_m = np.column_stack([np.interp(time_s[rows], frames, axis_m) for axis_m in truth_m.T])
        points_px[rows, elbow] = project(SIMULATION.cameras[number], at_m + np.array([0.09, 0.09, 0.08]))
        score[rows, elbow] = 0.9


def lose_wrist(camera: str, points_px: np.ndarray, score: np.ndarray, time_s: np.ndarray) -> None:
    rows = within(time_s, range(45, 60))
    points_px[rows, column("right_wrist")], score[rows, column("right_wrist")] = np.nan, 0.0


def keys(joint: str, *frames: int) -> list[PeopleEdit]:
    """Keys at true places."""
    return [
        KeyJoint(person=1, joint=joint, frame=frame, place_m=(float(x), float(y), float(z)))
        for frame in frames
        for x, y, z in [SIMULATION.truth_m[PERSON, frame, column(joint)]]
    ]


def ignored(joint: str, start: int, stop: int) -> list[PeopleEdit]:
    return [
        IgnoreDetections(person=1, camera=camera.name, part=joint, start_frame=start, stop_frame=stop)
        for camera in SIMULATION.cameras[:2]
    ]


def exchanged(people: People) -> People:
    """People of whom the person and the next one have each other's bodies from a frame on."""
    first, second = number_of(people.tracks), (number_of(people.tracks) + 1) % len(people.tracks)
    tracks, seen = list(people.tracks), list(people.observations)
    for one, other in ((first, second), (second, first)):
        tracks[one] = changed(people.tracks[one], people.tracks[other], list(tracks[one].joint_arrays))
        seen[one] = changed(people.observations[one], people.observations[other], ["points_px", "score", "detection"])
    return people._replace(tracks=tracks, observations=seen)


def changed(one: Any, other: Any, names: list[str]) -> Any:
    """Arrays of one until a frame, and of the other from then on."""
    return replace(
        one, **{name: np.concatenate([getattr(one, name)[:CUT], getattr(other, name)[CUT:]]) for name in names}
    )


def turned(people: People) -> People:
    """People of whom the person has left and right exchanged in some frames."""
    number = number_of(people.tracks)
    tracks, seen = list(people.tracks), list(people.observations)
    start, stop = TURNED.start - tracks[number].start_frame, TURNED.stop - tracks[number].start_frame
    arrays = {name: np.array(array) for name, array in tracks[number].joint_arrays.items()}
    for array in arrays.values():
        array[start:stop] = array[start:stop][:, OTHERS]
    points_px, score = np.array(seen[number].points_px), np.array(seen[number].score)
    for array in (points_px, score):
        array[start:stop] = array[start:stop][:, :, OTHERS]
    changed_arrays: dict[str, Any] = dict(arrays)
    tracks[number] = replace(tracks[number], **changed_arrays)
    seen[number] = replace(seen[number], points_px=points_px, score=score)
    return people._replace(tracks=tracks, observations=seen)


def number_of(tracks: Any) -> int:
    """Position of the track that begins as the person."""
    start_m = SIMULATION.truth_m[PERSON, 10]
    return min(range(len(tracks)), key=lambda k: float(np.nanmean(np.abs(tracks[k].xyz_m[10] - start_m))))


def right_m() -> tuple[float, float, float]:
    """Middle of the joints that the take with exchanged sides calls right: it is left."""
    lefts = [number for number, name in enumerate(SIMULATION.joints.names) if name.startswith("left")]
    x, y, z = SIMULATION.truth_m[PERSON, TURNED.start, lefts].mean(0)
    return float(x), float(y), float(z)


@dataclass(frozen=True)
class Fault:
    """A fault of a take, and the edits that mend it."""

    frames: range
    edits: list[PeopleEdit]
    change: Change | None = None  # of detections
    step: str = ""  # step of tracking that goes wrong, with its result
    spoil: Callable[[People], People] = exchanged


FAULTS = {
    # Sides that all cameras see exchanged need no edit.
    "seen_sides": Fault(TURNED, [], exchange_sides),
    "sides": Fault(
        TURNED,
        [ExchangeSides(person=1, part="all", start_frame=TURNED.start, stop_frame=TURNED.stop, left_m=right_m())],
        step="assign_limbs",
        spoil=turned,
    ),
    "elbow": Fault(range(40, 48), [*ignored("left_elbow", 40, 48), *keys("left_elbow", 41, 44, 46)], move_elbow),
    "wrist": Fault(range(45, 60), keys("right_wrist", 46, 49, 51, 53, 55, 58), lose_wrist),
    "identity": Fault(range(CUT, 100), [Exchange(person=1, other=2, start_frame=CUT)], step="assign_identities"),
}


def faulty(change: Change | None, folder: Path) -> KeypointSession:
    """A session of keypoint files with a fault."""
    detections = dict(SIMULATION.detections)
    for camera, seen in detections.items() if change is not None else ():
        mine = np.flatnonzero(SIMULATION.identities[camera] == PERSON)
        points_px, score = np.array(seen.keypoints_px), np.array(seen.score)
        of_person = points_px[mine], score[mine]
        assert change is not None
        change(camera, *of_person, SIMULATION.times[camera].time_s[seen.frame[mine]])
        points_px[mine], score[mine] = of_person
        detections[camera] = replace(seen, keypoints_px=points_px, score=score)
    write_simulation(replace(SIMULATION, detections=detections), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def joints_of(take: Reconstruction) -> np.ndarray:
    """Body joints of the person in all frames of the take, NaN where unknown."""
    track = take.tracks[number_of_whole(take)]
    xyz_m = np.full((SIMULATION.timebase.num_frames, len(BODY_JOINTS), 3), np.nan)
    xyz_m[track.frames] = track.xyz_m[:, take.joints.indices(BODY_JOINTS)]
    return xyz_m


def number_of_whole(take: Reconstruction) -> int:
    """Position of the track that begins as the person."""
    truth_m = SIMULATION.truth_m[PERSON]
    return min(
        range(len(take.tracks)),
        key=lambda k: float(np.nanmean(np.abs(take.tracks[k].xyz_m[:20] - truth_m[take.tracks[k].frames][:20]))),
    )


def error_mm(xyz_m: np.ndarray, frames: range) -> float:
    truth_m = SIMULATION.truth_m[PERSON][:, SIMULATION.joints.indices(BODY_JOINTS)]
    return 1000 * float(np.nanmean(np.linalg.norm(xyz_m - truth_m, axis=-1)[frames.start : frames.stop]))


def joints_of_file(take: Reconstruction, folder: Path) -> np.ndarray:
    """Body joints of the person in all frames, in a table."""
    exports: tuple[Export, ...] = ("csv",)
    write_results(take, folder, exports)
    number = take.tracks[number_of_whole(take)].track_id
    table = np.genfromtxt(folder / f"person-{number}.csv", delimiter=",", names=True)
    return np.stack([np.column_stack([table[f"{name}_{axis}_m"] for axis in "xyz"]) for name in BODY_JOINTS], axis=1)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[KeypointSession, Path]:
    return faulty(None, tmp_path_factory.mktemp("clean")), tmp_path_factory.mktemp("cache")


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_correction_of_planted_fault_lasts(
    name: str, clean: tuple[KeypointSession, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = FAULTS[name]
    assert len(fault.edits) <= 6
    whole, (clean_session, clean_cache) = range(SIMULATION.timebase.num_frames), clean
    session, cache = faulty(fault.change, tmp_path / "session"), tmp_path / "cache"

    def run(config: ReconstructionConfig, *edits: PeopleEdit) -> Reconstruction:
        """A run of the faulty capture; steps of tracking alone go wrong."""
        with monkeypatch.context() as patch:
            if fault.step and config.method == "tracking":
                assign = getattr(Association, fault.step)
                patch.setattr(Association, fault.step, lambda *given: fault.spoil(assign(*given)))
            return reconstruct(session, replace(config, edits=edits), cache=cache)

    found = run(PLAIN)
    write_people(tmp_path / "people", People(found.located, found.observations), joints=found.joints)
    of_run = StoredPeople(tmp_path / "people").spans
    person, other = (found.tracks[k].track_id for k in (number_of_whole(found), (number_of_whole(found) + 1) % 3))
    numbered = [numbered_by(edit, person, other) for edit in fault.edits]
    edits = place_edits(of_run, numbered, whole)
    assert [outcome.problem for outcome in apply_edits(of_run, edits, whole).outcomes] == [None] * len(edits)
    faults_mm = []
    for config in (PLAIN, *LATER):
        clean_m = joints_of(reconstruct(clean_session, config, cache=clean_cache))
        corrected_m = joints_of(run(config, *edits))
        assert error_mm(corrected_m, whole) < 1.1 * error_mm(clean_m, whole)
        faults_mm.append(error_mm(joints_of(run(config)), fault.frames) - error_mm(clean_m, fault.frames))
    assert max(faults_mm) > 5.0 or not edits
    corrected = run(PLAIN, *edits)
    in_file_m = joints_of_file(corrected, tmp_path / "files")
    assert error_mm(in_file_m, whole) == pytest.approx(error_mm(joints_of(corrected), whole), abs=0.1)


def numbered_by(edit: PeopleEdit, person: int, other: int) -> PeopleEdit:
    """Edit with the numbers that a run gives."""
    document = edit_document(edit) | {"person": person}
    return read_edit(document | {"other": other} if "other" in document else document)
