"""Biomechanics in a report: lines with gaps, ranges as words, names that are text, tables of gait and movements."""

import re
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from defusedxml import ElementTree

from pipeline.core.data.cameras import Timebase
from pipeline.export.report.biomechanics import (
    FORCE_COLUMNS,
    GAIT_COLUMNS,
    MOVEMENT_COLUMNS,
    PersonAngles,
    angle_parts,
    force_rows,
    gait_rows,
    movement_rows,
)
from pipeline.motion.angles.compute import JointAngles, ranges_of_motion
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.gait.analysis import gait_document, movement_documents
from pipeline.motion.gait.strides import Stride
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import Act, exercise, gait_of, walk


def person(name: str, columns_deg: dict[str, np.ndarray], num_frames: int) -> PersonAngles:
    angle_deg = np.full((num_frames, len(ANGLE_NAMES)), np.nan)
    for angle, line_deg in columns_deg.items():
        angle_deg[:, ANGLE_NAMES.index(angle)] = line_deg
    angles = JointAngles(30, angle_deg, np.where(np.isnan(angle_deg), np.nan, 1.5))
    return PersonAngles(name, angles, ranges_of_motion(angles))


def read(part: str) -> Any:
    """Part of a page, which is XML but for an attribute without a value."""
    return ElementTree.fromstring(part.replace("<details open>", '<details open="">'))


def test_lines_are_broken_where_angle_is_unknown() -> None:
    knee_deg = np.linspace(5.0, 65.0, 100)
    knee_deg[40:50] = np.nan
    known = person("person-1", {"left_knee_flexion": knee_deg, "right_knee_flexion": knee_deg[::-1]}, 100)
    (part,) = angle_parts([known], frame_rate_hz=10.0)
    page = read(part)
    assert "open" in page.attrib
    (svg,) = page.iter("svg")
    assert svg.attrib["aria-label"] == "Knee flexion from 5 to 65 degrees, left and right"
    left, right = svg.iter("path")
    assert [path.attrib["class"] for path in (left, right)] == ["left", "right"]
    assert left.attrib["d"].count("M") == 2
    assert left.attrib["d"].count("L") == 88
    heights = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", left.attrib["d"])]
    assert heights == sorted(heights, reverse=True)
    texts = [text.text for text in svg.iter("text")]
    assert {"20°", "40°", "60°", "3.0 s", "12.9 s"} <= set(texts)
    cells = [cell.text for cell in page.iter("td")]
    assert cells == ["5 to 65° ± 1.5", "5 to 65° ± 1.5", "bent"]


def test_long_takes_have_point_each_pixel() -> None:
    elbow_deg = 40.0 + 30.0 * np.sin(np.arange(5000) / 50.0)
    people = [person(name, {"right_elbow_flexion": elbow_deg}, 5000) for name in ("<script>", "person-2")]
    parts = list(angle_parts(people, frame_rate_hz=50.0))
    assert len(parts) == 2
    assert "<script>" not in parts[0]
    assert "&lt;script&gt;" in parts[0]
    page = read(parts[0])
    assert "open" not in page.attrib
    left, right = page.iter("path")
    assert left.attrib["d"] == ""
    assert right.attrib["d"].count("L") < 360
    assert [cell.text for cell in page.iter("td")] == ["-", "10 to 70° ± 1.5", "bent"]


def test_still_angle_fills_no_plot() -> None:
    still = person("person-1", {"left_hip_flexion": np.full(20, 3.0)}, 20)
    (part,) = angle_parts([still], frame_rate_hz=10.0)
    (line, _) = read(part).iter("path")
    heights = {float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", line.attrib["d"])}
    assert len(heights) == 1
    assert 40.0 < heights.pop() < 80.0


def stride(side: Literal["left", "right"], start: float, stop: float, is_steady: bool = True) -> Stride:
    durations = (0.6, 0.3, 0.36, 0.24, 0.12, 0.0)
    return Stride(side, 1, start, start + 18, start + 15, stop, 1.2, 0.6, 0.1, *durations, 1.2, 0.0, is_steady, 0.9)


def test_people_who_walk_have_plots_over_their_strides() -> None:
    rows = np.arange(120)
    knee_deg = 30.0 - 30.0 * np.cos(2 * np.pi * rows / 30.0)
    walker = person("person-1", {"left_knee_flexion": knee_deg, "right_knee_flexion": knee_deg}, 120)
    strides = (stride("left", 0, 30), stride("left", 30, 60), stride("left", 60, 75, is_steady=False))
    (part,) = angle_parts([replace(walker, strides=strides)], frame_rate_hz=30.0)
    _, over_strides = read(part).iter("svg")
    assert over_strides.attrib["aria-label"] == "Knee flexion over a stride: left, 2 strides"
    (path,) = over_strides.iter("path")
    heights = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", path.attrib["d"])]
    assert len(heights) == 101
    # Straight at both foot strikes, most bent half-way.
    assert heights[0] == heights[-1] == max(heights)
    assert min(heights) == heights[50]
    (band,) = over_strides.iter("polygon")
    assert len(band.attrib["points"].split()) == 202
    (plain,) = angle_parts([walker], frame_rate_hz=30.0)
    assert len(list(read(plain).iter("svg"))) == 1


TIMEBASE = Timebase(0.0, 60.0, 1000)


def figures(act: Act) -> dict[str, object]:
    return {"gait": gait_document(gait_of(act)), "movements": movement_documents(gait_of(act), TIMEBASE)}


def test_each_walker_has_row_for_both_feet_and_for_each() -> None:
    rows = gait_rows([("Anna", figures(walk(1.2))), ("Ben", figures(exercise(Gesture.SQUAT)))])
    assert [row[:2] for row in rows] == [("Anna", side) for side in ("both", "left", "right")]
    assert all(len(row) == len(GAIT_COLUMNS) for row in rows)
    document = gait_document(gait_of(walk(1.2)))
    assert document is not None
    length = document["both"]["stride_length_m"]
    assert rows[0][3] == f"{length['mean']:.2f} \N{PLUS-MINUS SIGN} {length['std']:.2f} m"
    assert int(rows[0][2]) == int(rows[1][2]) + int(rows[2][2])


def test_movements_have_their_height_or_depth() -> None:
    acts = exercise(Gesture.COUNTERMOVEMENT_JUMP), exercise(Gesture.SIT), walk(1.2)
    rows = movement_rows([(f"person {number}", figures(act)) for number, act in enumerate(acts)])
    assert all(len(row) == len(MOVEMENT_COLUMNS) for row in rows)
    assert {row[1] for row in rows if row[0] == "person 1"} == {"Sits down", "Stands up"}
    assert all("by flight time, " in row[4] and "by the hips" in row[4] for row in rows if row[1] == "Jump")
    assert not [row for row in rows if row[0] == "person 2"]


def test_forces_are_means_of_stances_and_asymmetry() -> None:
    stance = {"side": "left", "impulse_bw_s": 0.5, "peak_bw": 1.1, "loading_rate_bw_s": 8.0}
    found = {
        "id": 7,
        "mass_kg": 74.2,
        "mass_sigma_kg": 12.2,
        "mass_is_estimated": True,
        "stances": [stance, stance | {"peak_bw": 1.3}],
        "asymmetry_percent": {"impulse_bw_s": 3.2, "peak_bw": None, "loading_rate_bw_s": -10.0},
        "jumps": [{"by_impulse_m": 0.31}, {"by_impulse_m": 0.3}],
    }
    mass = "74 \N{PLUS-MINUS SIGN} 12 kg, estimated"
    left, right, apart = force_rows([("Ada", {"id": 7})], [found])
    assert left == (
        "Ada",
        mass,
        "left",
        "2",
        "0.50 BW s",
        "1.20 BW",
        "8.00 BW/s",
        "0.31 m, 0.30 m",
    )
    assert right == ("Ada", mass, "right", "0", "-", "-", "-", "0.31 m, 0.30 m")
    assert apart == ("Ada", "", "right less left", "", "+3 %", "-", "-10 %", "")
    assert len(left) == len(FORCE_COLUMNS)
