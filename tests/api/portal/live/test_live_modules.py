"""Modules of the view Live without a browser: packets as the service has them, zips, people without bones."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.packing import pack_instant, pack_keypoints
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton
from tests.api.portal.node import run_by_node

NUM_BONES = len(SKELETON)


def people() -> tuple[LivePerson, ...]:
    rng = np.random.default_rng(3)
    located = rng.normal(size=(17, 3))
    located[4] = np.nan
    skeleton = LiveSkeleton(
        rng.normal(size=3), rng.normal(size=(NUM_BONES, 4)), rng.normal(size=NUM_BONES), rng.normal(size=(NUM_BONES, 3))
    )
    return LivePerson(1, located, None), LivePerson(70_000, rng.normal(size=(17, 3)), skeleton)


def numbers(values: np.ndarray) -> list[float | None]:
    """Numbers as packets have them; JSON knows no NaN."""
    flat = np.asarray(values, np.float32).ravel().astype(float).tolist()
    return [None if np.isnan(value) else value for value in flat]


def test_modules_of_live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instant = LiveInstant(12.25, people(), 0.5)
    points_px = np.array([[[10.0, 20.0]] * 16 + [[np.nan, np.nan]]])
    score = np.array([[0.5] * 16 + [0.0]])
    (tmp_path / "instant.bin").write_bytes(pack_instant(instant, 17, NUM_BONES, 7))
    (tmp_path / "keypoints.bin").write_bytes(pack_keypoints(3, 1.5, points_px, score))
    rows = np.concatenate([points_px, score[..., None]], -1).reshape(-1).tolist()
    skeleton = instant.people[1].skeleton
    assert skeleton is not None
    expected = {
        "joint_names": COCO_17.names,
        "bones": [joint.name for joint in SKELETON],
        "parents": [joint.parent for joint in SKELETON],
        "located": [numbers(person.xyz_m) for person in instant.people],
        "skeleton": {
            "root": numbers(skeleton.root_m),
            "rotations": numbers(skeleton.parent_from_joint),
            "boneLengths": numbers(skeleton.bone_length_m),
            "joints": numbers(skeleton.joint_m),
        },
        "row": [None if np.isnan(value) else value for value in rows],
    }
    (tmp_path / "expected.json").write_text(json.dumps(expected), encoding="utf-8")
    person = {"pose_keypoints_2d": [1.0, 2.0, 0.5] * 17}
    for name, most_entries in (("cam_1", 65_535), ("cam_2", 2)):
        # Archives with more entries have another end: that of ZIP64.
        monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", most_entries)
        with zipfile.ZipFile(tmp_path / f"{name}.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for frame in (0, 2, 10):
                content = json.dumps({"people": [person] if frame else []})
                archive.writestr(f"a_{frame:012d}_keypoints.json", content)
    run_by_node(Path(__file__).parent / "live.test.mjs", tmp_path)
