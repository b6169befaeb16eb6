"""Content of C3D files of a laboratory: kinds of numbers, processors, numbers of frames, events, damage."""

import struct
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from pipeline.capture.laboratory import c3d_content
from pipeline.capture.laboratory.c3d_content import C3dError, read_content, read_parameters
from pipeline.core.data.laboratory import LaboratoryEvent
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import exercise
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes, plates_m, simulated

ACT = exercise(Gesture.JUMP)
LABORATORY = simulated(ACT, 0.0, 1.0, plates_m(ACT, ((0.2, 0.0),)))
EVENTS = {
    "EVENT": {
        "USED": [2],
        "LABELS": ["Foot Strike", "Foot Off"],
        "CONTEXTS": ["Left", "Right"],
        "SUBJECTS": ["S1", "S1"],
        "TIMES": np.array([[0.0, 1.5], [1.0, 0.25]]),
    }
}
MIPS, DEC = 86, 85


def as_dec(value: float) -> bytes:
    """Float of a VAX: exponents are greater by 2, and the words are swapped."""
    low, high = struct.unpack("<HH", struct.pack("<f", value * 4.0))
    return struct.pack("<HH", high, low)


def small_file(processor: int) -> bytes:
    """Two frames of a point and three channels with two samples a frame, as floats."""

    def word(number: int) -> bytes:
        return struct.pack(">H" if processor == MIPS else "<H", number)

    def real(number: float) -> bytes:
        return as_dec(number) if processor == DEC else struct.pack(">f", number)

    header = bytes([2, 0x50]) + b"".join(map(word, (1, 6, 1, 2, 0))) + real(-0.5) + word(3) + word(2) + real(200.0)
    scale = bytes([5, 1]) + b"SCALE"
    content = bytes([4, 1, 3]) + b"".join(map(real, (0.5, 2.0, -3.25))) + b"\0"
    group = bytes([6, 256 - 1]) + b"ANALOG" + word(3) + b"\0"
    parameters = bytes([1, 0x50, 1, processor]) + group + scale + word(0) + content
    frames = [[1.0, 2.0, 3.0, 0.0, *range(frame, frame + 6)] for frame in (10, 20)]
    data = b"".join(real(float(number)) for frame in frames for number in frame)
    return b"".join(part.ljust(512, b"\0") for part in (header, parameters, data))


@pytest.mark.parametrize("processor", [MIPS, DEC])
def test_files_of_other_processors_are_read(processor: int) -> None:
    content = read_content(small_file(processor))
    assert (content.frame_rate_hz, content.num_frames, content.samples_per_frame) == (200.0, 2, 2)
    np.testing.assert_array_equal(content.samples, [[10, 11, 12], [13, 14, 15], [20, 21, 22], [23, 24, 25]])
    np.testing.assert_array_equal(content.groups["ANALOG"]["SCALE"], [0.5, 2.0, -3.25])


@pytest.mark.parametrize("kind", ["<i2", "<f4"])
def test_samples_are_those_of_the_file_and_of_ezc3d(kind: str, tmp_path: Path) -> None:
    stored = c3d_bytes(LABORATORY, kind=kind)
    content = read_content(stored)
    np.testing.assert_array_equal(content.samples, LABORATORY.samples)
    (tmp_path / "a.c3d").write_bytes(stored)
    other = ezc3d.c3d(str(tmp_path / "a.c3d"))["data"]["analogs"][0]
    np.testing.assert_array_equal([LABORATORY.channel(column) for column in range(6)], other)


def test_unsigned_samples_are_positive() -> None:
    raised = type(LABORATORY)(
        **{name: getattr(LABORATORY, name) for name in LABORATORY.__slots__}
        | {"samples": np.abs(LABORATORY.samples) + np.float32(40_000.0)}
    )
    content = read_content(c3d_bytes(raised, {"ANALOG": {"FORMAT": ["UNSIGNED"]}}, kind="<u2"))
    np.testing.assert_array_equal(content.samples, raised.samples)


def test_events_count_from_the_first_frame_of_the_file() -> None:
    """Programs state times from frame 1 of the trial; of a cut file that is before its first frame."""
    late = read_content(c3d_bytes(LABORATORY, EVENTS, first_frame=101)).events
    assert late == (
        LaboratoryEvent("Foot Strike", "Left", "S1", 0.5),
        LaboratoryEvent("Foot Off", "Right", "S1", 59.25),
    )
    # Times before the first frame are from the file's own start.
    assert read_content(c3d_bytes(LABORATORY, EVENTS, first_frame=301)).events[0].time_s == 1.5


def test_frames_beyond_16_bits_are_in_the_parameters() -> None:
    header = c3d_content.C3dHeader(0, 1, 1, 65_535, -1.0, 3, 1, 100.0)
    trial = {"ACTUAL_START_FIELD": np.array([1, 0], "u2"), "ACTUAL_END_FIELD": np.array([4_464, 1], "u2")}
    assert c3d_content._num_frames(header, {"TRIAL": trial}) == 70_000
    assert c3d_content._num_frames(header, {"POINT": {"FRAMES": np.array([80_000.0], "f4")}}) == 80_000


def test_file_that_ends_early_is_refused() -> None:
    with pytest.raises(C3dError, match=r"The file states 100 frames, but ends after 9\d"):
        read_content(c3d_bytes(LABORATORY)[:-512])


def test_mutated_files_are_read_or_refused_with_a_sentence() -> None:
    stored = c3d_bytes(LABORATORY, EVENTS)
    sentences = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        content = bytearray(stored)
        for place in rng.integers(0, 2 * 512 if seed % 2 else 4 * 512, rng.integers(1, 12)):
            content[place] = rng.integers(0, 256)
        try:
            read_content(bytes(content[: rng.integers(1, len(content))] if seed % 5 == 0 else content))
        except C3dError as error:
            sentences.append(str(error))
    assert 50 < len(sentences) < 190
    assert all(sentence.endswith(".") for sentence in sentences)


def test_events_of_continued_parameters_are_read() -> None:
    """A parameter has at most 255 items; further ones are in ``TIMES2``. Times that are no numbers leave the rest."""
    times = np.stack([np.zeros(300), np.arange(300) / 100.0], axis=1)
    times[7, 1] = np.nan
    group = {"USED": [300], "LABELS": [f"E{k}" for k in range(300)], "TIMES": times}
    events = read_content(c3d_bytes(LABORATORY, {"EVENT": group}, first_frame=2)).events
    assert len(events) == 299
    assert (events[0].time_s, events[-1].label) == (0.0, "E299")
    assert events[-1].time_s == pytest.approx(2.99)


def test_numbers_that_are_texts_are_refused() -> None:
    trial = {"TRIAL": {"ACTUAL_START_FIELD": ["a", "b"], "ACTUAL_END_FIELD": ["c", "d"]}}
    with pytest.raises(C3dError, match="are damaged"):
        read_content(c3d_bytes(LABORATORY, trial, first_frame=65_500))


def test_points_are_read_beside_samples_without_parameters_of_channels() -> None:
    """ezc3d takes the samples of such a file for points; DEC and MIPS files it does not read."""
    stored = bytearray(small_file(MIPS))
    content = read_content(bytes(stored))
    assert content.points.tolist() == [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]]]
    place = stored.index(b"ANALOG")
    stored[place : place + 6] = b"OTHERS"
    content = read_content(bytes(stored))
    assert "ANALOG" not in content.groups
    assert content.points.tolist() == [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]]]


def test_negative_residual_makes_point_unknown() -> None:
    stored = bytearray(small_file(MIPS))
    stored[1024 + 12 : 1024 + 16] = struct.pack(">f", -1.0)
    points = read_content(bytes(stored)).points
    assert np.isnan(points[0]).all()
    assert points[1].tolist() == [[1.0, 2.0, 3.0]]


def test_channels_in_place_of_samples_in_header_are_multiplied() -> None:
    """The MotionMonitor's header states three channels of two samples as three numbers a frame."""
    stored = small_file(MIPS).replace(struct.pack(">HHHH", 1, 6, 1, 2), struct.pack(">HHHH", 1, 3, 1, 2), 1)
    used = bytes([4, 1]) + b"USED" + struct.pack(">H", 6) + bytes([2, 0]) + struct.pack(">H", 3) + b"\0"
    place = stored.index(bytes([5, 1]) + b"SCALE")
    stored = stored[:place] + used + stored[place : 1024 - len(used)] + stored[1024:]
    content = read_content(stored)
    np.testing.assert_array_equal(content.samples, [[10, 11, 12], [13, 14, 15], [20, 21, 22], [23, 24, 25]])


def test_parameters_beyond_stated_blocks_are_read() -> None:
    group = {"LABELS": ["x" * 120] * 4}
    stored = bytearray(c3d_bytes(LABORATORY, {"NOTES": group}))
    assert stored[514] > 1
    stored[514] = 1
    assert read_content(bytes(stored)).groups["NOTES"]["LABELS"] == group["LABELS"]


def test_file_of_neither_points_nor_numbers_with_damaged_place_is_refused() -> None:
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 0, 1, 1, 0, -1.0, 0, 1, 100.0)
    with pytest.raises(C3dError, match="are damaged"):
        read_content(header.ljust(512, b"\0") + bytes([1, 0x50, 1, 84]).ljust(512, b"\0"))


def test_parameters_in_the_bytes_of_each_other_are_refused() -> None:
    overlapping = bytes([1, 1]) + b"A" + struct.pack("<HbBBB", 6, 1, 2, 255, 255)
    parameters = bytes(4) + 20_000 * overlapping
    with pytest.raises(ValueError, match=r"^$"):
        read_parameters(parameters)
    assert read_parameters(bytes(4) + overlapping + bytes(65_025)) == {}
