"""Events in C3D files, and the tables of events and strides, as other software reads them."""

import csv
import io
import json
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import BODY_FEET
from pipeline.export.writers import c3d_file
from pipeline.export.writers.angle_tables import gait_tables
from pipeline.motion.gait.analysis import MarkedEvent, PersonGait, gait_document, marked_events, movement_documents
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import exercise, gait_of, performed, track_of, walk
from tests.pipeline.validation.simulation.true_events import flights_s, step_times

ACT = walk(1.2)
TIMEBASE = Timebase(2.0, 60.0, 1000)


def written(path: Path, events: tuple[MarkedEvent, ...], frames: range | None = None) -> Path:
    path.write_bytes(b"".join(c3d_file.encode(track_of(ACT), BODY_FEET, TIMEBASE, np.zeros(3), frames, events)))
    return path


@pytest.mark.parametrize("first_frame", [0, -40])
def test_ezc3d_reads_events_of_walk(tmp_path: Path, first_frame: int) -> None:
    events = marked_events(gait_of(ACT))
    frames = range(first_frame, track_of(ACT).num_frames)
    group = ezc3d.c3d(str(written(tmp_path / "person.c3d", events, frames)))["parameters"]["EVENT"]
    (number,) = group["USED"]["value"]
    assert number == len(events) > 10
    times_s = np.array([60.0, 1.0]) @ group["TIMES"]["value"] + first_frame / 60.0
    read = list(zip(group["CONTEXTS"]["value"], group["LABELS"]["value"], strict=True))
    for foot, side in enumerate(("Left", "Right")):
        true_s = step_times(performed(ACT))[foot].strikes_s[:-1]
        found_s = [time_s for time_s, named in zip(times_s, read, strict=True) if named == (side, "Foot Strike")]
        assert max(np.abs(np.array(found_s) - time_s).min() for time_s in true_s) < 1 / 120
    assert set(read) == {(side, f"Foot {kind}") for side in ("Left", "Right") for kind in ("Strike", "Off")}


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_c3d_reads_events_too(tmp_path: Path) -> None:
    events = marked_events(gait_of(ACT))
    with written(tmp_path / "person.c3d", events).open("rb") as file:
        group = c3d.Reader(file).get("EVENT")
        labels = [label.strip() for label in group.get("LABELS").string_array]
        contexts = [context.strip() for context in group.get("CONTEXTS").string_array]
        times = group.get("TIMES").float_array
    assert labels == [event.label for event in events]
    assert contexts == [event.context for event in events]
    np.testing.assert_allclose(times.reshape(-1, 2)[:, 1], [event.frame / 60.0 for event in events], atol=1e-5)


def test_files_without_events_have_no_group(tmp_path: Path) -> None:
    parameters = ezc3d.c3d(str(written(tmp_path / "person.c3d", ())))["parameters"]
    assert parameters.get("EVENT", {}).get("LABELS", {}).get("value", []) == []
    assert list(gait_tables(PersonGait(0), TIMEBASE)) == []


def test_tables_have_row_event_and_row_stride() -> None:
    gait = gait_of(ACT)
    tables = {
        kind: list(csv.DictReader(io.StringIO(content.decode()))) for kind, content in gait_tables(gait, TIMEBASE)
    }
    assert [row["event"] for row in tables["events"]] == [
        mark.label.lower().replace(" ", "_") for mark in marked_events(gait)
    ]
    assert float(tables["events"][0]["time_s"]) == pytest.approx(2.0 + gait.events[0].row / 60, abs=1e-4)
    assert len(tables["strides"]) == len(gait.strides)
    first, stride = tables["strides"][0], gait.strides[0]
    assert float(first["strike_s"]) == pytest.approx(2.0 + stride.strike_row / 60, abs=1e-4)
    assert float(first["stride_length_m"]) == pytest.approx(stride.length_m, abs=1e-4)
    assert (first["side"], first["bout"], first["is_steady"]) == (stride.side, "1", "1")


def test_jumps_are_events_of_both_feet() -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP)
    ((kind, content),) = gait_tables(gait_of(act), TIMEBASE)
    rows = list(csv.DictReader(io.StringIO(content.decode())))
    assert kind == "events"
    assert {row["side"] for row in rows} == {"both"}
    takeoffs_s = [float(row["time_s"]) for row in rows if row["event"] == "take_off"]
    np.testing.assert_allclose(np.array(takeoffs_s) - 2.0, flights_s(performed(act))[:, 0], atol=1 / 60)


def test_documents_are_plain_values_and_empty_without_gait() -> None:
    document = gait_document(gait_of(ACT))
    assert document is not None
    assert json.loads(json.dumps(document)) == document
    hip_m = track_of(ACT).xyz_m[150:210, BODY_FEET.index("left_hip"), :2]
    assert document["both"]["speed_m_s"]["mean"] == pytest.approx(
        np.linalg.norm(hip_m[-1] - hip_m[0]) * 60 / 59, abs=0.03
    )
    assert document["both"]["stride_length_m"]["num"] == document["num_strides"]
    assert document["treadmill_m_s"] is None
    assert document["events_of"] == "heels and toes"
    assert gait_document(PersonGait(0)) is None
    jumps = movement_documents(gait_of(exercise(Gesture.COUNTERMOVEMENT_JUMP)), TIMEBASE)
    assert [set(jump) for jump in jumps] == [
        {"kind", "start_s", "duration_s", "confidence", "height_by_flight_m", "height_by_hips_m"}
    ] * len(jumps)
    assert jumps[0]["start_s"] > 2.0
