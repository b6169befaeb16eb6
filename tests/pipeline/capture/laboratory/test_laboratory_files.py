"""Laboratory files beside a session: clocks, place of the axes, problems."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.laboratory.laboratory_files import with_laboratory
from pipeline.capture.points import SessionMaker
from pipeline.capture.preflight_npz import decode_keypoints, decode_session
from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.errors import InputError
from pipeline.motion.laboratory.plates import plate_corners_m
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.video.info import Timecode, VideoInfo
from pipeline.video.properties.container_clocks import timecode_s
from tests.pipeline.motion.gait.walks import exercise
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated
from tests.pipeline.motion.skeleton.observed import ring_of
from tests.records import encode_record

ACT = exercise(Gesture.JUMP)
PLATES = simulated(ACT, 0.0, 1.0, plates_m(ACT, ((0.2, 0.0),)))


def session(start_s: float = 0.0) -> KeypointSession:
    keypoints_px = np.tile(np.linspace(100.0, 400.0, 34).reshape(17, 2), (3, 25, 1, 1))
    times_s = start_s + np.arange(25) / 25.0
    return SessionMaker.from_arrays(keypoints_px, None, ring_of(3), times_s=times_s, joints="coco-17")


def with_channel(name: str, samples: np.ndarray, given: Laboratory = PLATES) -> Laboratory:
    """Laboratory with one more channel."""
    analog: dict[str, Any] = {**given.groups["ANALOG"]}
    more: dict[str, Any] = {
        "USED": np.array([7], "u2"),
        "LABELS": [*analog["LABELS"], name],
        "UNITS": [*analog["UNITS"], "V"],
        "SCALE": np.append(analog["SCALE"], np.float32(0.001)),
        "OFFSET": np.zeros(7, "u2"),
    }
    groups = {**given.groups, "ANALOG": {**analog, **more}}
    columns = np.concatenate([given.samples, samples[:, None]], axis=1).astype(np.float32)
    return replace(given, samples=columns, groups=groups)


def trigger(row: int = 370) -> np.ndarray:
    return np.where(np.arange(1000) >= row, 5000.0, 12.0) + np.arange(1000) % 3


def read(folder: Path, laboratory: Laboratory, more: Any = None, **options: Any) -> Laboratory:
    path = folder / "trial.c3d"
    path.write_bytes(c3d_bytes(laboratory, more or {}))
    found = with_laboratory(options.pop("session", None) or session(), path, **options).laboratory
    assert found is not None
    return found


def refused(folder: Path, laboratory: Laboratory, **options: Any) -> str:
    with pytest.raises(InputError) as raised:
        read(folder, laboratory, **options)
    return str(raised.value.problems[0])


def test_trigger_rises_when_the_first_frame_is_taken(tmp_path: Path) -> None:
    start = read(tmp_path, with_channel("Sync out", trigger()), session=session(2.0)).start
    assert start is not None
    assert start.clock == "trigger"
    # The rise is between the samples 369 and 370.
    assert start.time_s == pytest.approx(2.0 - 0.3695, abs=1e-9)
    assert start.sigma_s == pytest.approx(0.001 / np.sqrt(12.0))


def test_named_channel_is_the_trigger(tmp_path: Path) -> None:
    laboratory = with_channel("EMG 7", trigger(100))
    assert read(tmp_path, laboratory).start is None
    start = read(tmp_path, laboratory, clock="trigger", channel="EMG 7").start
    assert start is not None
    assert start.time_s == pytest.approx(-0.0995, abs=1e-9)


@pytest.mark.parametrize("samples", [np.sin(np.arange(1000.0)) * 900.0, np.zeros(1000), trigger(0)])
def test_channel_without_two_levels_is_no_trigger(samples: np.ndarray, tmp_path: Path) -> None:
    laboratory = with_channel("Trigger", samples)
    assert read(tmp_path, laboratory).start is None
    message = refused(tmp_path, laboratory, clock="trigger")
    assert "No channel is a trigger" in message
    assert "Fx1" in message


def test_timecode_beside_a_video(tmp_path: Path) -> None:
    """The file begins 2 frames after midnight, the video 25 frames before it."""
    time_s = timecode_s("23:59:59:00", Fraction(25))
    assert time_s is not None
    pts = np.arange(25)
    of_video = Timecode(time_s, 25.0)
    video = VideoInfo(Path("cam0.mp4"), "h264", (4, 4), 0, pts, pts[:1], pts / 25.0, 25.0, timecode=of_video)
    (camera,) = ring_of(1)
    filmed = CaptureSession((camera,), (video,), {camera.name: FrameTimes(0.5 + pts / 25.0)}, ())
    path = tmp_path / "trial.c3d"
    path.write_bytes(c3d_bytes(PLATES, {"TRIAL": {"TIMECODE": ["00:00:00:02"]}}))
    for clock in ("timecode", "auto"):
        given = with_laboratory(filmed, path, clock)
        stored = decode_session(encode_record(given), tmp_path).laboratory
        for laboratory in (given.laboratory, stored):
            assert laboratory is not None
            assert laboratory.start is not None
            assert laboratory.start.clock == "timecode"
            assert laboratory.start.time_s == pytest.approx(0.5 + 27 / 25.0)
            assert laboratory.start.sigma_s == pytest.approx(0.04 / np.sqrt(12.0))


def test_timecode_that_is_missing_is_named(tmp_path: Path) -> None:
    assert "no timecode" in refused(tmp_path, PLATES, clock="timecode")


def test_file_without_plates_needs_a_clock(tmp_path: Path) -> None:
    emg = replace(PLATES, groups={**PLATES.groups, "FORCE_PLATFORM": {"USED": np.array([0], "u2")}})
    assert "no force plates" in refused(tmp_path, emg, clock="contacts")
    assert "No channel is a trigger" in refused(tmp_path, emg)


def test_place_turns_and_moves_the_plates(tmp_path: Path) -> None:
    corners_m = plate_corners_m(read(tmp_path, PLATES, place=(1.0, 2.0, 0.5, 90.0)))
    turned_m = plate_corners_m(PLATES)[..., [1, 0, 2]] * [-1.0, 1.0, 1.0] + [1.0, 2.0, 0.5]
    np.testing.assert_allclose(corners_m, turned_m, atol=1e-6)


def test_left_over_bytes_as_corners_turn_no_plates(tmp_path: Path) -> None:
    plates = PLATES.groups["FORCE_PLATFORM"]
    bytes_mm = np.array([(-5.9e10, 0.0, 0.0), (0.0, 0.0, 9.0e15), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    corners_mm = np.concatenate([np.array(plates["CORNERS"]).reshape(-1, 4, 3), [bytes_mm]])
    count = np.array([len(corners_mm)], "u2")
    doubled = {name: np.concatenate([plates[name]] * 2) for name in ("TYPE", "ORIGIN", "CHANNEL")}
    more = {**plates, **doubled, "USED": count, "CORNERS": corners_mm.astype("f4")}
    laboratory = read(tmp_path, replace(PLATES, groups={**PLATES.groups, "FORCE_PLATFORM": more}))
    np.testing.assert_allclose(laboratory.world_from_laboratory.rotation, np.eye(3), atol=1e-9)


def test_plates_of_a_world_with_y_up_lie_on_the_floor(tmp_path: Path) -> None:
    plates = PLATES.groups["FORCE_PLATFORM"]
    corners = np.asarray(plates["CORNERS"])[..., [0, 2, 1]] * [1.0, 1.0, -1.0]
    groups = {**PLATES.groups, "FORCE_PLATFORM": {**plates, "CORNERS": corners.astype("f4")}}
    np.testing.assert_allclose(plate_corners_m(read(tmp_path, replace(PLATES, groups=groups)))[..., 2], 0.0, atol=1e-6)


def test_finding_states_channels_and_the_guess(tmp_path: Path) -> None:
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(with_channel("Trigger", trigger())))
    finding = with_laboratory(session(), tmp_path / "trial.c3d").findings[-1]
    assert finding.code == "laboratory_read"
    assert finding.message == (
        "trial.c3d has 7 channels at 1000 Hz, 1 force plates and 0 events; it begins at -0.3695 s by the rise of "
        "channel Trigger (chosen automatically), at which the first frame is taken, +- 0.3 ms."
    )


def test_damaged_and_missing_files_are_named(tmp_path: Path) -> None:
    for path, words in ((tmp_path / "none.c3d", "can't be read"), (tmp_path / "text.c3d", "no C3D file")):
        if "text" in path.name:
            path.write_text("not a C3D file " * 100)
        with pytest.raises(InputError, match=words) as raised:
            with_laboratory(session(), path)
        assert raised.value.problems[0].file == path.name


def test_mutated_plates_are_read_or_refused_with_a_sentence(tmp_path: Path) -> None:
    stored = c3d_bytes(with_channel("Trigger", trigger()))
    given, path, refusals = session(), tmp_path / "a.c3d", []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        content = bytearray(stored)
        for place in rng.integers(512, 2048, rng.integers(1, 20)):
            content[place] = rng.integers(0, 256)
        path.write_bytes(content)
        try:
            with_laboratory(given, path)
        except InputError as error:
            refusals.append(str(error.problems[0].message))
    assert 10 < len(refusals) < 100
    assert all(message.endswith(".") for message in refusals)


def test_record_of_a_session_holds_the_laboratory(tmp_path: Path) -> None:
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(with_channel("Trigger", trigger())))
    given = with_laboratory(session(), tmp_path / "trial.c3d", place=(1.0, 0.0, 0.0, 30.0))
    found, expected = decode_keypoints(encode_record(given)).laboratory, given.laboratory
    assert found is not None
    assert expected is not None
    np.testing.assert_array_equal(found.samples, expected.samples)
    np.testing.assert_array_equal(found.world_from_laboratory.matrix, expected.world_from_laboratory.matrix)
    np.testing.assert_array_equal(plate_corners_m(found), plate_corners_m(expected))
    assert found.start == expected.start
    assert found.texts("ANALOG", "LABELS") == expected.texts("ANALOG", "LABELS")
    assert encode_record(decode_keypoints(encode_record(given))) == encode_record(given)
    assert decode_keypoints(encode_record(session())).laboratory is None


def test_channels_that_result_files_can_not_hold_are_refused(tmp_path: Path) -> None:
    analog = {"ANALOG": {"DESCRIPTIONS": ["x" * 255] * 200}}
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(PLATES, analog))
    with pytest.raises(InputError, match="more than 40,000 bytes: keep fewer channels"):
        with_laboratory(session(), tmp_path / "trial.c3d")


def test_record_leaves_out_parameters_of_unprintable_names(tmp_path: Path) -> None:
    """Names in the record's archive end at a zero byte."""
    analog = {"ANALOG": {"A\0B": np.ones(3, "f4"), "A\0C": np.zeros(3, "f4"), "GAIN": np.ones(2, "f4")}}
    (tmp_path / "trial.c3d").write_bytes(c3d_bytes(PLATES, analog))
    given = with_laboratory(session(), tmp_path / "trial.c3d")
    found = decode_keypoints(encode_record(given)).laboratory
    assert found is not None
    assert "GAIN" in found.groups["ANALOG"]
    assert all(name.isprintable() for name in found.groups["ANALOG"])
