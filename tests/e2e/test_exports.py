"""Exports of the sample and of a simulated walk, opened in independent software."""

import json
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import c3d
import ezc3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trc import TRCData

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import SIDES, finger_joints
from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M
from pipeline.motion.skeleton.model import INDEX, SKELETON, find_skeleton, forward_kinematics
from tests.e2e.conftest import NUM_FIRST
from tests.e2e.exported import (
    EXPORTS,
    IN_BLENDER,
    IN_FILE,
    OF_PRESETS,
    PRESET_NAMES,
    PYTHON_READERS,
    QUICK_PRESETS,
    Y_UP,
    ExportedCapture,
    assert_same,
    is_a_picture_of_people,
    on_captures,
    with_channels,
)
from tests.e2e.foreign import (
    Animated,
    read_with_assimp,
    read_with_blender,
    read_with_three,
    read_with_ufbx,
    validate_with_khronos,
)
from tests.pipeline.export.bvh_readers import read_with_bvhio


def beginning_of(path: Path, folder: Path) -> Path:
    """Write the first frames of a BVH file to a file of its own."""
    head, motion = path.read_text().split("Frames:")
    _, time_line, *rows = motion.splitlines()
    first = rows[:NUM_FIRST]
    target = folder / path.name
    target.write_text("\n".join([f"{head}Frames: {len(first)}", time_line, *first, ""]))
    return target


# Both take seconds for a whole file: three.js reads those of more presets, and they their first frames.
@pytest.mark.parametrize(
    ("capture", "read", "preset"),
    on_captures(
        [(read, "default") for read in PYTHON_READERS],
        [(read, preset) for read in PYTHON_READERS for preset in PRESET_NAMES],
    ),
    indirect=["capture"],
)
def test_bvh_in_python(
    capture: ExportedCapture, tmp_path: Path, read: Callable[[Path], dict[str, np.ndarray]], preset: Preset
) -> None:
    axes, units_per_m = IN_FILE[preset]
    for path, motion in capture.paths("bvh", preset).items():
        expected_m = forward_kinematics(motion)
        if preset == "default":
            found = read(path)
        else:
            found, expected_m = read(beginning_of(path, tmp_path)), expected_m[:NUM_FIRST]
        for joint in with_channels(motion):
            expected = expected_m[:, INDEX[joint]] @ axes.T * units_per_m
            assert_same(found[PRESETS[preset].name(joint)], expected, 1e-3 * units_per_m, (path, joint))


# three.js's loader does not find joints whose names contain a colon.
@pytest.mark.parametrize(
    ("capture", "preset"),
    on_captures(QUICK_PRESETS, [preset for preset in PRESET_NAMES if preset != "mixamo"]),
    indirect=["capture"],
)
def test_bvh_in_three(capture: ExportedCapture, preset: Preset) -> None:
    axes, units_per_m = IN_FILE[preset]
    paths = capture.paths("bvh", preset)
    for path, read in read_with_three(list(paths)).items():
        motion = paths[path]
        expected_m = forward_kinematics(motion)
        assert read.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-6)
        for joint in with_channels(motion):
            expected = expected_m[:, INDEX[joint]] @ axes.T * units_per_m
            assert_same(read.positions[PRESETS[preset].name(joint)], expected, 1e-3 * units_per_m, (path, joint))


def test_glb_in_three(capture: ExportedCapture) -> None:
    paths = capture.paths("glb")
    for path, read in read_with_three(list(paths)).items():
        motion = paths[path]
        assert read.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-4)
        expected_m = forward_kinematics(motion)
        for index, joint in enumerate(find_skeleton(expected_m.shape[1])):
            assert_same(read.positions[joint.name], expected_m[:, index] @ Y_UP.T, 1e-4, (path, joint.name))


def test_glb_is_valid_gltf(capture: ExportedCapture) -> None:
    for path, issues in validate_with_khronos(list(capture.paths("glb"))).items():
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), (path, issues["messages"])


# The quick run opens the files of one preset in the readers that it has.
@pytest.mark.parametrize(
    ("capture", "read", "preset"),
    on_captures(
        [(read, "default") for read in (read_with_three, read_with_assimp)],
        [(read, preset) for read in (read_with_three, read_with_assimp, read_with_ufbx) for preset in PRESET_NAMES],
    ),
    indirect=["capture"],
)
def test_fbx_elsewhere(
    capture: ExportedCapture, read: Callable[[Sequence[Path]], dict[Path, Animated]], preset: Preset
) -> None:
    units_per_m = 1.0 if preset == "blender" else 100.0
    paths = capture.paths("fbx", preset)
    for path, found in read(list(paths)).items():
        motion = paths[path]
        assert found.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-4)
        expected_m = forward_kinematics(motion)
        names = [PRESETS[preset].name(joint.name) for joint in find_skeleton(expected_m.shape[1])]
        assert set(found.positions) == set(names)
        for index, name in enumerate(names):
            assert_same(found.positions[name], units_per_m * expected_m[:, index] @ Y_UP.T, 1e-4 * units_per_m, path)


def markers_m(track: Track3D, names: tuple[str, ...]) -> np.ndarray:
    """Joints of a track without the fingers of hands in frames in which nobody saw the hand."""
    seen_m = track.xyz_m.copy()
    for side in SIDES:
        is_finger = np.array([name in finger_joints(side) for name in names])
        is_seen = np.asarray(np.isin(track.source[:, is_finger], (Source.MEASURED, Source.INTERPOLATED)).any(1))
        seen_m[~is_seen[:, None] & is_finger] = np.nan
    return seen_m


def test_markers(capture: ExportedCapture) -> None:
    tracks = {track.track_id: track for track in capture.reconstruction.tracks}
    joints, rate_hz = capture.reconstruction.joints.names, capture.reconstruction.timebase.frame_rate_hz
    for path, motion in capture.paths("c3d").items():
        expected_m = markers_m(tracks[motion.track_id], joints)
        known = np.isfinite(expected_m).all(-1)
        read = ezc3d.c3d(str(path))
        labels = read["parameters"]["POINT"]["LABELS"]["value"]
        assert labels == [*joints, "center_of_mass", "extrapolated_center_of_mass"]
        assert read["header"]["points"]["frame_rate"] == pytest.approx(rate_hz)
        found_m = np.transpose(read["data"]["points"][:3], (2, 1, 0))[:, : len(joints)] / 1e3
        np.testing.assert_array_equal(np.isfinite(found_m).all(-1), known)
        assert_same(found_m[known], expected_m[known], 1e-4, path)
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a warning that there are no analog channels
            frames = np.array([points for _, points, _ in c3d.Reader(file).read_frames()])
        assert_same(frames[:, : len(joints)][known][:, :3] / 1e3, expected_m[known], 1e-4, path)
    for path, motion in capture.paths("trc").items():
        expected_m = markers_m(tracks[motion.track_id], joints)
        known = np.isfinite(expected_m).all(-1)
        table = TRCData()
        table.load(str(path))
        assert int(table["NumFrames"]) == len(expected_m)
        assert float(table["DataRate"]) == pytest.approx(rate_hz)
        found_m = np.array([table[number + 1][1] for number in range(len(expected_m))], dtype=float)
        assert_same(found_m[known], (expected_m @ Y_UP.T)[known], 1e-4, path)


@pytest.mark.parametrize(("capture", "preset"), on_captures(QUICK_PRESETS, PRESET_NAMES), indirect=["capture"])
def test_metrics_say_how_far_joints_are_in_each_format(capture: ExportedCapture, preset: Preset) -> None:
    check = json.loads((capture.of_preset(preset) / "metrics.json").read_bytes())["exports"]
    assert set(check) == {"skeletons", *(EXPORTS if preset == "default" else OF_PRESETS)}
    assert check["bvh"]["max_distance_mm"] < 0.5


def test_metrics_say_distance_in_formats_without_presets(capture: ExportedCapture) -> None:
    check = json.loads((capture.of_preset("default") / "metrics.json").read_bytes())["exports"]
    assert max(check.pop(export)["max_difference_deg"] for export in ("angles", "mot")) < 0.001
    assert check.pop("forces")["max_difference_si"] < 0.001
    assert max(check[export]["max_distance_mm"] for export in check if export != "bvh") < 0.1


def test_animations_are_where_fit_has_joints(capture: ExportedCapture) -> None:
    """Joints of the skeleton have the final positions of the track."""
    joints = capture.reconstruction.joints
    own = {one.name: one.landmarks[0] for one in SKELETON if len(one.landmarks) == 1}
    assert len(own) == 12
    for track, (path, motion) in zip(capture.reconstruction.tracks, capture.paths("bvh").items(), strict=True):
        assert track.track_id == motion.track_id
        found = read_with_bvhio(path)
        for name, landmark in own.items():
            expected_m = track.xyz_m[:, joints.index(landmark)]
            known = np.isfinite(expected_m).all(-1)
            assert_same(found[name][known], (expected_m[known] @ Y_UP.T) * 100.0, 0.1, (path, name))


@pytest.mark.parametrize("preset", PRESET_NAMES)
def test_nothing_flips(capture: ExportedCapture, preset: Preset) -> None:
    """No joint turns by more than 45 degrees between frames in which it and its bones' ends move less than 5 cm."""
    for motion in capture.reconstruction.motions:
        positions_m = forward_kinematics(motion)
        moved_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=-1)
        quat_xyzw = PRESETS[preset].parent_from_joint(motion.parent_from_joint)
        skeleton = find_skeleton(len(motion.bone_length_m))
        for joint in with_channels(motion):
            ends = [INDEX[one.name] for one in skeleton if joint in (one.name, one.parent)]
            calm = (moved_m[:, ends] < 0.05).all(-1)
            turn = Rotation.from_quat(quat_xyzw[:, INDEX[joint]])
            step_deg = np.degrees((turn[:-1].inv() * turn[1:]).magnitude())
            assert step_deg[calm].max(initial=0.0) <= 45.0, (motion.name, joint)


@pytest.mark.blender
def test_blender(capture: ExportedCapture, tmp_path: Path) -> None:
    """In each frame people are upright, face the right way, and stand at their place in the world."""
    rate_hz = capture.reconstruction.timebase.frame_rate_hz
    opened: dict[Path, tuple[Preset, SkeletonMotion, float]] = {
        path: ("default", motion, 1e-4) for path, motion in capture.paths("glb").items()
    }
    files: list[tuple[Path, float, dict[str, object]]] = [(path, rate_hz, {}) for path in opened]
    if "usd" in EXPORTS:
        for path, motion in capture.paths("usd").items():
            opened[path] = ("default", motion, 1e-4)
            files.append((path, rate_hz, {}))
    for preset in PRESET_NAMES:
        for path, motion in capture.paths("bvh", preset).items():
            opened[path] = (preset, motion, 1e-3)
            files.append((path, rate_hz, IN_BLENDER[preset]))
        for path, motion in capture.paths("fbx", preset).items():
            opened[path] = (preset, motion, 1e-4)
            files.append((path, rate_hz, {}))
    pictures = Path(os.environ.get("MULTICAP_PICTURES", tmp_path)).absolute()
    pictures.mkdir(parents=True, exist_ok=True)
    picture = pictures / f"{capture.name}.jpg"
    found = read_with_blender(files, tmp_path, picture)
    for path, (preset, motion, tolerance_m) in opened.items():
        read, name = found[path], PRESETS[preset].name
        assert read.frame_rate_hz == pytest.approx(rate_hz, rel=1e-6)
        rest = {joint: read.rest[name(joint)] for joint in with_channels(motion)}
        assert rest["Head"][2] > rest["Hips"][2] + 0.4 > rest["LeftFoot"][2] + 1.0
        assert rest["LeftHand"][0] > 0.3 > -0.3 > rest["RightHand"][0]
        expected_m = forward_kinematics(motion)
        names = [joint.name for joint in find_skeleton(len(motion.bone_length_m))]
        for joint in with_channels(motion) if path.suffix == ".bvh" else names:
            assert_same(read.positions[name(joint)], expected_m[:, INDEX[joint]], tolerance_m, (path, joint))
        if path.suffix == ".glb":
            assert read.rest["LeftFootEnd"][1] < read.rest["LeftFoot"][1] - 0.05  # it faces -Y
    floor = capture.reconstruction.animation.floor
    assert floor is not None
    ankles_m = [
        found[path].positions[f"{contact.side.capitalize()}Foot"][contact.rows]
        for path, motion in capture.paths("glb").items()
        for contact in motion.contacts
    ]
    # Over all people: at the place of the sample's bystander the calibration has the floor 15 cm higher.
    assert np.median(floor.height_m(np.concatenate(ankles_m))) == pytest.approx(ANKLE_HEIGHT_M, abs=0.05)
    assert is_a_picture_of_people(picture)
