"""Captures with all exports, and how the tests compare what other software reads from them."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import FINGER_JOINTS, SIDES, JointSet, finger_joints, hand_bones
from pipeline.core.options.config import Preset, ReconstructionConfig
from pipeline.core.options.file_formats import FILE_FORMATS, Export, file_ending, formats_of_people, installed_formats
from pipeline.export.presets import PRESETS
from pipeline.export.results import write_results
from pipeline.motion.skeleton.model import SKELETON, find_skeleton, forward_kinematics
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record, simulation_files
from tests.pipeline.export.bvh_readers import read_with_bvh_converter, read_with_bvhio
from tests.pipeline.export.writers.test_bvh import with_fingers

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


def is_a_picture_of_people(path: Path) -> bool:
    """Tell whether something bright and colourful stands on the grey floor."""
    image = cv2.imread(str(path))
    assert image is not None
    return bool((np.ptp(image.astype(int), axis=-1) > 100).mean() > 0.005)
