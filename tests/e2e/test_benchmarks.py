"""MVOR and CMU Panoptic from pictures and videos: a rendered capture in their forms; skipped without its folder."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.calibration.registry import read_calibration
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.datasets.mvor import ANNOTATIONS, JOINTS
from pipeline.validation.evaluation.datasets.rendered import load_rendered
from tests.e2e.datasets import folder_of, needs
from tests.pipeline.validation.evaluation.datasets.mvor_files import cameras_info, image_id, write_json
from tests.pipeline.validation.evaluation.datasets.panoptic_files import body_entry, write_calibration, write_poses

RENDERED = folder_of("rendered")
FRAMES = (8, 30, 52, 74)
_MIDDLES = {"head": "ear", "neck": "shoulder"}


def cameras() -> tuple[Camera, ...]:
    return read_calibration(RENDERED / "calibration.toml")


def truth() -> tuple[list[dict[str, np.ndarray]], ...]:
    """Joints of the people in each frame by name."""
    known = load_rendered(RENDERED)
    return tuple(
        [dict(zip(known.names, xyz_m, strict=True)) for xyz_m in known.xyz_m[:, frame] if np.isfinite(xyz_m).all()]
        for frame in range(len(known.time_s))
    )


def scores_of(*command: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["evaluate", *command, "--profile=fast", "--json"])
    assert result.exit_code == 0, result.output
    scores: dict[str, Any] = json.loads(result.stdout)
    return scores


def picture_of(frame: av.VideoFrame) -> Image.Image:
    return Image.fromarray(frame.to_ndarray(format="rgb24"))


def write_pictures(folder: Path, camera: str, place: int) -> None:
    """Write the frames of a camera as MVOR's pictures of two days."""
    with av.open(str(RENDERED / "videos" / f"{camera}.mp4")) as video:
        pictures = {
            k: Image.fromarray(frame.to_ndarray(format="rgb24"))
            for k, frame in enumerate(video.decode(video=0))
            if k in FRAMES
        }
    for number, frame in enumerate(FRAMES):
        path = folder / f"day{1 + number // 2}" / f"cam{place}" / "color" / f"{number % 2:06}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures[frame].save(path)


def annotated_m(person: Mapping[str, np.ndarray]) -> np.ndarray:
    """Joints of MVOR of a person."""
    sides = [[person[f"{side}_{_MIDDLES[name]}"] for side in ("left", "right")] for name in JOINTS[:2]]
    return np.array([*np.mean(sides, axis=1), *(person[name] for name in JOINTS[2:])])


@needs("rendered")
def test_pictures_of_mvor(tmp_path: Path) -> None:
    rig, people = cameras()[:3], truth()
    first = rig[0].cam_from_world
    instants, annotations, located = [], [], []
    for place, camera in enumerate(rig, 1):
        write_pictures(tmp_path / "camma_mvor_dataset", camera.name, place)
    for number, frame in enumerate(FRAMES):
        day = 1 + number // 2
        images = [
            {
                "id": image_id(day, place, number % 2),
                "file_name": f"day{day}/cam{place}/color/{number % 2:06}.png",
            }
            for place in (1, 2, 3)
        ]
        instants.append({"id": f"{number}", "images": images})
        for person in people[frame]:
            xyz_m = annotated_m(person)
            of_first_mm = 1000 * (xyz_m @ first.rotation.T + first.translation_m)
            points = np.concatenate([np.pad(of_first_mm, ((0, 2), (0, 0))), np.full((12, 1), 2.0)], axis=1)
            located.append({"image_ids": f"{number}", "keypoints3D": points.ravel().tolist()})
            for image, camera in zip(images, rig, strict=True):
                joints_px = project(camera, xyz_m)
                annotations.append(
                    {
                        "image_id": image["id"],
                        "only_bbox": 0,
                        "bbox": [*joints_px.min(0), *np.ptp(joints_px, axis=0)],
                        "keypoints": np.concatenate([joints_px, np.full((10, 1), 2.0)], axis=1).ravel().tolist(),
                    }
                )
    document = {
        "multiview_images": instants,
        "annotations": annotations,
        "annotations3D": located,
        "cameras_info": cameras_info(rig),
    }
    write_json(tmp_path / ANNOTATIONS, document)
    scores = scores_of("mvor", f"--data={tmp_path}")
    assert (scores["instants"], scores["people"]) == (4, 12)
    assert scores["recall"] >= 0.8
    assert scores["mpjpe_mm"] < 60.0
    assert scores["pck_2d"]["shoulder"] > 0.8


@needs("rendered")
@pytest.mark.parametrize("kind", ["videos", "images"])
def test_sequence_of_panoptic(tmp_path: Path, kind: str) -> None:
    names = {"cam_0": "00_03", "cam_1": "00_06", "cam_2": "00_12", "cam_3": "00_13"}
    folder = tmp_path / "171204_pose1"
    write_calibration(folder, {names[camera.name]: camera for camera in cameras()})
    for frame, people in enumerate(truth()):
        write_poses(folder, frame, [body_entry(number, person) for number, person in enumerate(people)])
    for camera, name in names.items():
        video = RENDERED / "videos" / f"{camera}.mp4"
        if kind == "videos":
            (folder / "hdVideos").mkdir(exist_ok=True)
            shutil.copy(video, folder / "hdVideos" / f"hd_{name}.mp4")
        else:
            (folder / "hdImgs" / name).mkdir(parents=True)
            with av.open(str(video)) as opened:
                for number, picture in enumerate(opened.decode(video=0)):
                    if 20 <= number < 40:
                        picture_of(picture).save(folder / "hdImgs" / name / f"{name}_{number:08}.jpg", quality=95)
    frames = "--frames=20:40" if kind == "videos" else "--frames=0:20"
    scores = scores_of("panoptic", f"--data={folder}", f"--cameras={','.join(names.values())}", "--every=4", frames)
    assert (scores["instants"], scores["people"]) == (5, 15)
    assert scores["recall"] > 0.8
    assert scores["mpjpe_mm"] < 40.0
    assert scores["ap"]["150"] > 0.8
