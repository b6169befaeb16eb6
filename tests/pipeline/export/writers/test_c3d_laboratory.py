"""Files of people with a laboratory's channels, plates and events, by ezc3d and c3d."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import c3d
import ezc3d
import numpy as np
import pytest

from pipeline.capture.laboratory.c3d_content import read_content
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.laboratory import Laboratory, LaboratoryEvent, LaboratoryStart
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import BODY_FEET
from pipeline.export.writers import c3d_file
from pipeline.export.writers.body_mesh import CAPSULES
from pipeline.export.writers.registry import PersonContent
from pipeline.motion.skeleton.model import forward_kinematics
from pipeline.validation.simulation.motion.performance import joints_at
from tests.pipeline.export.writers.test_bvh import walk as motion_of
from tests.pipeline.motion.forces.physical_people import estimated
from tests.pipeline.motion.gait.walks import performed, track_of, walk
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated

ACT = walk(1.2)
START_S, LAG_S = 3.0, 0.4321
ORIGIN_M = np.array([1.0, -2.0, 0.0])
MOVED = Rigid3(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.5, 0.25, 0.0]))
EVENT = LaboratoryEvent("Foot Strike", "Left", "S1", 1.25)


def laboratory(unit: str = "mm", length_s: float = 4.0) -> Laboratory:
    given = simulated(ACT, LAG_S, length_s, plates_m(ACT, ((0.0, 0.0), (0.6, 0.0))))
    groups = dict(given.groups)
    if unit == "m":
        plates = groups["FORCE_PLATFORM"]
        groups["FORCE_PLATFORM"] = {**plates, "CORNERS": np.asarray(plates["CORNERS"]) / np.float32(1000.0)}
    start = LaboratoryStart("trigger", START_S + LAG_S, 0.0003)
    placed: dict[str, Any] = {"world_from_laboratory": MOVED, "start": start, "events": (EVENT,)}
    return replace(given, unit=unit, groups=groups, **placed)


def content(of_laboratory: Laboratory | None) -> PersonContent:
    track = track_of(ACT)
    motion = motion_of(track.num_frames)
    frames = track.frames
    clock = Timebase(START_S, ACT.rate_hz, track.num_frames)
    present, skeleton = np.ones(len(frames), bool), lambda: forward_kinematics(motion)
    shared = track, motion, BODY_FEET, clock, "person-1.c3d", frames, present, ORIGIN_M, "default", CAPSULES
    return PersonContent(*shared, skeleton, lambda: None, laboratory=of_laboratory)  # type: ignore[arg-type, return-value]


def written(path: Path, of_laboratory: Laboratory | None) -> Path:
    path.write_bytes(b"".join(c3d_file.WRITER.encode(content(of_laboratory))))
    return path


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_samples_of_ezc3d_are_bit_equal(unit: str, tmp_path: Path) -> None:
    given = laboratory(unit)
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(given))
    before = ezc3d.c3d(str(tmp_path / "trial.c3d"), extract_forceplat_data=True)
    after = ezc3d.c3d(str(written(tmp_path / "a.c3d", given)), extract_forceplat_data=True)
    np.testing.assert_array_equal(after["data"]["analogs"], before["data"]["analogs"])
    for name in ("LABELS", "UNITS", "SCALE", "OFFSET", "GEN_SCALE", "RATE"):
        np.testing.assert_array_equal(
            after["parameters"]["ANALOG"][name]["value"], before["parameters"]["ANALOG"][name]["value"]
        )
    # Forces stay, along axes that turned; corners are in the world, from the origin of the file.
    for plate, old in zip(after["data"]["platform"], before["data"]["platform"], strict=True):
        np.testing.assert_allclose(plate["force"], MOVED.rotation @ old["force"], atol=1e-3)
        per_m = 1000.0 if unit == "mm" else 1.0
        corners_m = MOVED.apply(old["corners"].T / per_m) - ORIGIN_M
        np.testing.assert_allclose(plate["corners"].T / per_m, corners_m, atol=1e-5)


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_points_are_at_the_times_of_the_laboratory(unit: str, tmp_path: Path) -> None:
    read = ezc3d.c3d(str(written(tmp_path / "a.c3d", laboratory(unit))))
    assert read["parameters"]["POINT"]["UNITS"]["value"] == [unit]
    points_m = read["data"]["points"][:3].transpose(2, 1, 0) / (1000.0 if unit == "mm" else 1.0) + ORIGIN_M
    true_m = joints_at(performed(ACT), LAG_S + np.arange(400) / 100.0)
    assert points_m.shape == true_m.shape
    # Lines between frames of 60 Hz.
    np.testing.assert_allclose(points_m, true_m, atol=0.004)
    assert read["data"]["rotations"].shape[3] == 400


def test_file_is_read_back_as_expected(tmp_path: Path) -> None:
    person = content(laboratory())
    path = written(tmp_path / "a.c3d", laboratory())
    frames = c3d_file.WRITER.frames(person)
    assert frames == range(400)
    read_m = np.concatenate(list(c3d_file.WRITER.read(path, "default")))
    np.testing.assert_allclose(read_m, c3d_file.WRITER.expected(person)(frames), atol=1e-6)


def test_events_of_both_are_in_order_of_time(tmp_path: Path) -> None:
    group = ezc3d.c3d(str(written(tmp_path / "a.c3d", laboratory())))["parameters"]["EVENT"]
    plain = ezc3d.c3d(str(written(tmp_path / "b.c3d", None)))["parameters"]["EVENT"]
    minutes, seconds = group["TIMES"]["value"]
    times_s = 60.0 * minutes + seconds
    assert (np.diff(times_s) >= 0.0).all()
    of_laboratory = np.array(group["SUBJECTS"]["value"]) == "S1"
    assert times_s[of_laboratory] == pytest.approx([1.25])
    own_s = plain["TIMES"]["value"][1] - LAG_S
    np.testing.assert_allclose(times_s[~of_laboratory], own_s[(own_s >= 0.0) & (own_s <= 4.0)], atol=1e-5)


def test_frames_of_the_file_beyond_the_take_have_no_points(tmp_path: Path) -> None:
    read = ezc3d.c3d(str(written(tmp_path / "a.c3d", laboratory(length_s=9.0))))
    known = read["data"]["meta_points"]["residuals"][0].T >= 0.0
    last = int((ACT.duration_s - LAG_S) * 100.0)
    assert known[: last - 2].all()
    assert not known[last + 2 :].any()
    assert read["data"]["analogs"].shape == (1, 12, 9000)


def test_other_library_reads_points_and_samples(tmp_path: Path) -> None:
    given = laboratory()
    with written(tmp_path / "a.c3d", given).open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about parameters that the format does not ask for
        frames = list(c3d.Reader(file).read_frames())
    samples = np.concatenate([of_frame for _, _, of_frame in frames], axis=1)
    np.testing.assert_allclose(samples, [given.channel(column) for column in range(12)], rtol=1e-6, atol=1e-6)


def test_file_without_time_or_common_frames_is_as_ever(tmp_path: Path) -> None:
    plain = written(tmp_path / "a.c3d", None).read_bytes()
    for start in (None, LaboratoryStart("trigger", 500.0, 0.0)):
        assert written(tmp_path / "b.c3d", replace(laboratory(), start=start)).read_bytes() == plain


def test_unsigned_offsets_and_any_names_are_kept(tmp_path: Path) -> None:
    given = laboratory()
    analog = {**given.groups["ANALOG"], "FORMAT": ["UNSIGNED"], "OFFSET": np.full(12, 40_000, "u2"), "NAME_É": ["é"]}
    raised = replace(given, groups={**given.groups, "ANALOG": analog}, samples=given.samples + np.float32(40_000.0))
    content_of = read_content(written(tmp_path / "a.c3d", raised).read_bytes())
    again = replace(raised, samples=content_of.samples, groups=content_of.groups)
    np.testing.assert_array_equal(again.channel(3), given.channel(3))
    assert content_of.groups["ANALOG"]["NAME_É"] == ["é"]


def test_events_of_long_words_leave_room_for_the_rest(tmp_path: Path) -> None:
    events = tuple(LaboratoryEvent("L" * 255, "C" * 255, "S" * 255, k / 100.0) for k in range(1000))
    written_events = read_content(written(tmp_path / "a.c3d", replace(laboratory(), events=events)).read_bytes()).events
    assert 50 < len(written_events) == 64_000 // (8 + 3 * 255)
    assert written_events[0].time_s == 0.0


def test_measured_plates_are_not_joined_by_estimated_ones(tmp_path: Path) -> None:
    given = replace(content(laboratory()), forces=lambda: estimated(ACT))
    path = tmp_path / "a.c3d"
    path.write_bytes(b"".join(c3d_file.WRITER.encode(given)))
    assert path.read_bytes() == written(tmp_path / "b.c3d", laboratory()).read_bytes()
    path.write_bytes(b"".join(c3d_file.WRITER.encode(replace(given, laboratory=None))))
    assert len(ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"]) == 2
