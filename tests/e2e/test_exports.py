"""Exports of the sample and of a simulated walk, opened in independent software."""

import json
import os
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import c3d
import cv2
import ezc3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trc import TRCData

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import FINGER_JOINTS, SIDES, JointSet, finger_joints, hand_bones
from pipeline.core.options.config import Preset, ReconstructionConfig
from pipeline.core.options.file_formats import FILE_FORMATS, Export, file_ending, formats_of_people, installed_formats
from pipeline.export.presets import PRESETS
from pipeline.export.results import write_results
from pipeline.export.writers import fbx
from pipeline.export.writers.rotation_orders import rotation_orders
from pipeline.motion.skeleton.feet.floor import ANKLE_HEIGHT_M
from pipeline.motion.skeleton.model import INDEX, SKELETON, find_skeleton, forward_kinematics
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.files import simulation_files
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.conftest import NUM_FIRST
from tests.e2e.foreign import (
    Animated,
    read_with_assimp,
    read_with_blender,
    read_with_three,
    read_with_ufbx,
    validate_with_khronos,
)
from tests.pipeline.export.blender_curves import positions_in_blender
from tests.pipeline.export.bvh_readers import read_with_bvh_converter, read_with_bvhio
from tests.pipeline.export.writers.test_bvh import encoded, half_way_of, orders_in, tumbling, with_fingers

EXPORTS = formats_of_people(installed_formats())
OF_PRESETS = tuple(export for export, form in FILE_FORMATS.items() if form.has_presets)
PRESET_NAMES = tuple(PRESETS)
# Files of the others are written and read by the slow tests: two of them have all there is in axes and units.
QUICK_PRESETS: tuple[Preset, ...] = ("default", "unreal")
PYTHON_READERS = (read_with_bvh_converter, read_with_bvhio)
# World axes of a file's x, y and z, and units a metre.
WORLD, Y_UP = np.eye(3), np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
IN_FILE: dict[Preset, tuple[np.ndarray, float]] = {
    "default": (Y_UP, 100.0),
    "blender": (Y_UP, 1.0),
    "unity-humanoid": (Y_UP, 1.0),
    "unreal": (WORLD, 100.0),
    "mixamo": (Y_UP, 100.0),
    "humanik": (Y_UP, 100.0),
}
# Settings of Blender's importer.
IN_BLENDER: dict[Preset, dict[str, object]] = {
    "default": {"global_scale": 0.01},
    "blender": {},
    "unity-humanoid": {},
    "unreal": {"global_scale": 0.01, "axis_forward": "Y", "axis_up": "Z"},
    "mixamo": {"global_scale": 0.01},
    "humanik": {"global_scale": 0.01},
}


FBX_IMPORTERS: dict[str, dict[str, object]] = {"addon": {}, "built-in": {"importer": "wm.fbx_import"}}


def with_channels(motion: SkeletonMotion) -> list[str]:
    """Names of the joints that have channels in BVH files."""
    return [joint.name for joint in find_skeleton(len(motion.bone_length_m)) if not joint.name.endswith("End")]


@dataclass(frozen=True, slots=True, eq=False)
class ExportedCapture:
    """Reconstruction with all exports; files of each preset are in their own folder, written for who asks first."""

    name: str
    reconstruction: Reconstruction
    folder: Path

    def paths(self, export: Export, preset: Preset = "default") -> dict[Path, SkeletonMotion]:
        folder = self.of_preset(preset)
        return {folder / f"{person.name}.{file_ending(export)}": person for person in self.reconstruction.motions}

    def of_preset(self, preset: Preset) -> Path:
        """Folder of a preset's files."""
        folder = self.folder / preset
        if not folder.exists():
            write_results(self.reconstruction, folder, EXPORTS if preset == "default" else OF_PRESETS, preset)
        return folder


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> ExportedCapture:
    folder = tmp_path_factory.mktemp("walk")
    for name, content in simulation_files(record(replace(find_scene("walk"), duration_s=3.0), seed=0)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    session = open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv", None)
    return ExportedCapture("walk", reconstruct(session, ReconstructionConfig()), folder)


@pytest.fixture(scope="session")
def filmed(reconstruction: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> ExportedCapture:
    return ExportedCapture("sample", reconstruction, tmp_path_factory.mktemp("filmed"))


@pytest.fixture(scope="session")
def hands(walk: ExportedCapture, tmp_path_factory: pytest.TempPathFactory) -> ExportedCapture:
    """The simulated walk with fingers that turn, also in the tracks."""
    body = walk.reconstruction
    joints = JointSet(
        names=(*body.joints.names, *(name for side in SIDES for name in finger_joints(side))),
        bones=(*body.joints.bones, *(bone for side in SIDES for bone in hand_bones(side))),
    )
    motions = tuple(with_fingers(motion) for motion in body.motions)
    tracks = tuple(with_finger_joints(track, motion) for track, motion in zip(body.tracks, motions, strict=True))
    whole = replace(
        body,
        joints=joints,
        located=[with_finger_joints(track, None) for track in body.located],
        observations=[
            replace(seen, points_px=padded(seen.points_px, -2, np.nan), score=padded(seen.score, -1, 0.0))
            for seen in body.observations
        ],
        animation=replace(body.animation, tracks=tracks, motions=motions),
    )
    return ExportedCapture("hands", whole, tmp_path_factory.mktemp("hands"))


def padded(values: np.ndarray, axis: int, value: float) -> np.ndarray:
    """Append the joints of all fingers to the joints' axis of an array."""
    width = [(0, 0)] * values.ndim
    width[axis] = (0, len(FINGER_JOINTS))
    return np.pad(values, width, constant_values=value)


def with_finger_joints(track: Track3D, motion: SkeletonMotion | None) -> Track3D:
    """Add the joints of all fingers to a track: predicted by a motion, or absent without."""
    xyz_m = padded(track.xyz_m, 1, np.nan)
    if motion is not None:
        xyz_m[:, -len(FINGER_JOINTS) :] = forward_kinematics(motion)[:, len(SKELETON) :]
    return replace(
        track,
        xyz_m=xyz_m,
        score=padded(track.score, 1, 0.0),
        source=padded(track.source, 1, Source.ABSENT if motion is None else Source.PREDICTED),
        error_px=padded(track.error_px, 1, np.nan),
        views=padded(track.views, 1, 0),
        uncertainty_m=None if track.uncertainty_m is None else padded(track.uncertainty_m, 1, np.nan),
    )


# The process that tests the sample has its reconstruction.
FILMED = pytest.param("filmed", marks=[pytest.mark.slow, pytest.mark.xdist_group("sample")])


@pytest.fixture(params=["walk", FILMED, "hands"])
def capture(request: pytest.FixtureRequest) -> ExportedCapture:
    return request.getfixturevalue(request.param)


def on_captures(of_all: Collection[Any], others: Iterable[Any]) -> list[Any]:
    """Cases of a test by capture: some with each of them, and others, slowly, with the one that has all joints."""
    cases = [case if isinstance(case, tuple) else (case,) for case in of_all]
    rest = [case if isinstance(case, tuple) else (case,) for case in others]
    return [
        *((name, *case) for name in ("walk", "hands") for case in cases),
        *(pytest.param("filmed", *case, marks=FILMED.marks) for case in cases),
        *(pytest.param("hands", *case, marks=pytest.mark.slow) for case in rest if case not in cases),
    ]


def assert_same(found: np.ndarray, expected: np.ndarray, tolerance: float, what: object) -> None:
    assert found.shape == expected.shape, what
    assert np.linalg.norm(found - expected, axis=-1).max() <= tolerance, what


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


def test_order_for_each_joint_in_three(tmp_path: Path) -> None:
    motion, path = tumbling(), tmp_path / "person.bvh"
    path.write_bytes(encoded(motion))
    assert len(set(orders_in(path.read_bytes()).values())) > 1
    read = read_with_three([path])[path]
    for joint in with_channels(motion):
        expected_cm = forward_kinematics(motion)[:, INDEX[joint]] @ Y_UP.T * 100.0
        assert_same(read.positions[joint], expected_cm, 0.1, joint)


@pytest.mark.blender
def test_order_for_each_joint_in_blender(tmp_path: Path) -> None:
    motion, path = tumbling(), tmp_path / "person.bvh"
    path.write_bytes(encoded(motion, "blender"))
    assert len(set(orders_in(path.read_bytes()).values())) > 1
    read = read_with_blender([(path, motion.frame_rate_hz, IN_BLENDER["blender"])], tmp_path)[path]
    for joint in with_channels(motion):
        expected_m = forward_kinematics(motion)[:, INDEX[joint]]
        assert_same(read.positions[PRESETS["blender"].name(joint)], expected_m, 1e-3, joint)


def off_half_way_mm(read: Animated, motion: SkeletonMotion, preset: Preset) -> float:
    """Largest distance of a joint from its place half-way between frames where rotations take the shortest arcs."""
    expected_m, name = forward_kinematics(half_way_of(motion)), PRESETS[preset].name
    return 1e3 * max(
        float(np.linalg.norm(read.positions[name(joint)] - expected_m[:, INDEX[joint]], axis=-1).max())
        for joint in with_channels(motion)
    )


@pytest.mark.blender
@pytest.mark.parametrize("name", ["walk", FILMED, "hands", "tumbling"])
def test_between_frames_in_blender(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """BVH is within 3 mm half-way between frames, FBX within 0.1 mm, and the metrics state no less."""
    motions = [tumbling()] if name == "tumbling" else request.getfixturevalue(name).reconstruction.motions
    files: dict[Path, tuple[Preset, SkeletonMotion]] = {}
    opened: list[tuple[Path, float, Mapping[str, object]]] = []
    for preset, motion in product(PRESET_NAMES, motions):
        path = tmp_path / f"{preset}-{motion.track_id}.bvh"
        path.write_bytes(encoded(motion, preset))
        opened.append((path, motion.frame_rate_hz, IN_BLENDER[preset]))
        files[path] = preset, motion
        for importer in {} if preset not in QUICK_PRESETS else FBX_IMPORTERS:
            path = tmp_path / f"{preset}-{motion.track_id}-{importer}.fbx"
            path.write_bytes(b"".join(fbx.encode(motion, preset, np.zeros(3))))
            opened.append((path, motion.frame_rate_hz, FBX_IMPORTERS[importer]))
            files[path] = preset, motion
    read = read_with_blender(opened, tmp_path, half_way=True)
    for path, (preset, motion) in files.items():
        off_mm = off_half_way_mm(read[path], motion, preset)
        if path.suffix == ".fbx":
            assert off_mm < 0.1, path.name
            continue
        # Unity's plug-in demands one order for all joints, whatever Blender makes of it.
        assert off_mm < (4.0 if PRESETS[preset].is_order_demanded else 3.0), path.name
        between = rotation_orders(motion, PRESETS[preset], "Blender").between
        # The metrics count the ends of bones too, which Blender has no positions of.
        assert between is not None
        assert between.distance_mm > off_mm - 0.05, path.name


def test_between_frames_of_fbx_in_ufbx(tmp_path: Path) -> None:
    """ufbx interpolates the angles of a file; ``metrics.json`` has the largest distance."""
    motion, path = tumbling(frame_rate_hz=5.0), tmp_path / "person.fbx"  # ufbx resamples slow keys alone
    path.write_bytes(b"".join(fbx.encode(motion, "default", np.zeros(3))))
    between = rotation_orders(motion, fbx.convention_of_fbx("default"), "ufbx").between
    expected_cm = forward_kinematics(half_way_of(motion)) @ Y_UP.T * 100.0
    read = read_with_ufbx([path], half_way=True)[path]
    off_mm = [
        np.linalg.norm(read.positions[joint.name] - expected_cm[:, index], axis=-1).max() * 10.0
        for index, joint in enumerate(SKELETON)
    ]
    assert between is not None
    assert between.distance_mm == pytest.approx(max(off_mm), abs=0.02)
    assert max(off_mm) < 1.0


@pytest.mark.blender
def test_blenders_curves_are_those_of_tests(tmp_path: Path) -> None:
    """The rule by which quick tests read BVH between frames is Blender's, also where joints whirl."""
    random = np.random.default_rng(7)
    calm, files = tumbling(80), {}
    for step_deg in (5.0, 20.0, 40.0):
        steps = Rotation.from_rotvec(np.radians(step_deg) * random.normal(size=(80 * len(SKELETON), 3)))
        turns = np.array(steps.as_quat()).reshape(80, len(SKELETON), 4)
        for before, after in pairwise(turns):
            after[:] = (Rotation.from_quat(before) * Rotation.from_quat(after)).as_quat()
        for preset in QUICK_PRESETS:
            path = tmp_path / f"{preset}-{step_deg}.bvh"
            path.write_bytes(encoded(replace(calm, parent_from_joint=turns), preset))
            files[path] = preset
    opened = [(path, calm.frame_rate_hz, IN_BLENDER[preset]) for path, preset in files.items()]
    read = read_with_blender(opened, tmp_path, half_way=True)
    for path, preset in files.items():
        axes, units_per_m = IN_FILE[preset]
        for name, found in positions_in_blender(path.read_bytes(), half_way=True).items():
            if name in read[path].positions:
                assert_same(read[path].positions[name], found @ axes / units_per_m, 1e-4, (path.name, name))


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
        assert read["parameters"]["POINT"]["LABELS"]["value"] == list(joints)
        assert read["header"]["points"]["frame_rate"] == pytest.approx(rate_hz)
        found_m = np.transpose(read["data"]["points"][:3], (2, 1, 0)) / 1e3
        np.testing.assert_array_equal(np.isfinite(found_m).all(-1), known)
        assert_same(found_m[known], expected_m[known], 1e-4, path)
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a warning that there are no analog channels
            frames = np.array([points for _, points, _ in c3d.Reader(file).read_frames()])
        assert_same(frames[known][:, :3] / 1e3, expected_m[known], 1e-4, path)
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


def is_a_picture_of_people(path: Path) -> bool:
    """Whether something bright and colourful stands on the grey floor."""
    image = cv2.imread(str(path))
    assert image is not None
    return bool((np.ptp(image.astype(int), axis=-1) > 100).mean() > 0.005)
