"""Exports between frames: rotation orders and curves, as Blender, three.js and ufbx read them."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS
from pipeline.export.writers import fbx
from pipeline.export.writers.rotation_orders import rotation_orders
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from tests.e2e.exported import (
    FBX_IMPORTERS,
    FILMED,
    IN_BLENDER,
    IN_FILE,
    PRESET_NAMES,
    QUICK_PRESETS,
    Y_UP,
    assert_same,
    with_channels,
)
from tests.e2e.foreign import (
    Animated,
    read_with_blender,
    read_with_three,
    read_with_ufbx,
)
from tests.pipeline.export.blender_curves import positions_in_blender
from tests.pipeline.export.writers.test_bvh import encoded, half_way_of, orders_in, tumbling


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
