"""Files in the form of MVOR, made from simulated people."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project
from pipeline.validation.evaluation.datasets.mvor import ANNOTATIONS, JOINTS
from pipeline.validation.simulation.scenes import Simulation, find_scene, record

ONLY_BOX = 2
"""Person who has boxes alone."""


def simulate_room(num_views: int = 3) -> Simulation:
    """Three people in a room, seen by cameras without distortion, as MVOR's."""
    scene = find_scene("room")
    scene = replace(scene, rig=replace(scene.rig, distortion=(0.0,) * 5), duration_s=8.0)
    return record(scene, seed=1, num_views=num_views)


def annotated_m(simulation: Simulation, frames: Sequence[int]) -> np.ndarray:
    """MVOR's ten joints, people x frames x 10 x 3: head and neck are the middles of ears and of shoulders."""
    xyz_m = simulation.truth_m[:, np.array(frames)]
    of = simulation.joints

    def middle(name: str) -> np.ndarray:
        return xyz_m[:, :, of.indices((f"left_{name}", f"right_{name}"))].mean(2, keepdims=True)

    return np.concatenate([middle("eye"), middle("shoulder"), xyz_m[:, :, of.indices(JOINTS[2:])]], axis=2)


def _rows(rotation: np.ndarray, translation_mm: np.ndarray) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation_mm
    return matrix.ravel().tolist()


def cameras_info(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Cameras in MVOR's form; the distortion is one that its pictures do not have."""
    first = cameras[0].cam_from_world
    extrinsics = []
    for camera in cameras:
        pose = camera.cam_from_world
        rotation = first.rotation @ pose.rotation.T
        extrinsics.append(_rows(rotation, 1000 * (first.translation_m - rotation @ pose.translation_m)))
    return {
        "date_identifier": "20150331",
        "camParams": {
            "firstCamToRoomRef": _rows(first.rotation.T, 1000 * center_in_world(cameras[0])),
            "ids": [str(number) for number in range(len(cameras))],
            "extrinsics": extrinsics,
            "intrinsics": [
                {
                    "serialnumber": str(number),
                    "skew_value": 0,
                    "distortion": [0.0267, -1.6653, 13.3344, -0.0025, 0.0002],
                    "principalpoint": camera.matrix[:2, 2].tolist(),
                    "focallength": camera.matrix[[0, 1], [0, 1]].tolist(),
                    "imagesize": list(camera.size_px),
                }
                for number, camera in enumerate(cameras)
            ],
        },
    }


def image_id(day: int, camera: int, number: int) -> int:
    return day * 10**10 + camera * 10**7 + number


def mvor_document(simulation: Simulation, frames: Sequence[int]) -> dict[str, Any]:
    """Annotations of frames, each an instant: half of them on a first day, the others on a second one."""
    xyz_m = annotated_m(simulation, frames)
    first = simulation.cameras[0].cam_from_world
    days = [(1, k) if k < len(frames) // 2 else (2, k - len(frames) // 2) for k in range(len(frames))]
    images: list[dict[str, Any]] = []
    instants: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    people: list[dict[str, Any]] = []
    for column, (day, number) in enumerate(days):
        of_instant = []
        for place, camera in enumerate(simulation.cameras, 1):
            image = {
                "height": camera.size_px[1],
                "width": camera.size_px[0],
                "date_captured": f"2015-04-0{day} 06:{number:02}:08.947101",
                "file_name": f"day{day}/cam{place}/color/{number:06}.png",
                "id": image_id(day, place, number),
                "cam_id": place,
                "day_id": day,
            }
            of_instant.append(image)
            for person, joints_px in enumerate(project(camera, xyz_m[:, column])):
                low, high = joints_px.min(0), joints_px.max(0)
                only_box = int(person == ONLY_BOX)
                annotations.append(
                    {
                        "id": len(annotations),
                        "image_id": image["id"],
                        "person_id": -1 if only_box else person,
                        "person_role": "clinician",
                        "category_id": "1",
                        "bbox": [*low, *(high - low)],
                        "only_bbox": only_box,
                        "keypoints": [0.0] * 30
                        if only_box
                        else np.concatenate([joints_px, np.full((10, 1), 2.0)], axis=1).ravel().tolist(),
                    }
                )
        images += of_instant
        name = "_".join(str(image["id"]) for image in of_instant)
        instants.append({"id": name, "images": of_instant})
        for person in range(len(xyz_m)):
            if person != ONLY_BOX:
                # The joints of the hands follow the ten; nobody has looked at where they are.
                of_first_mm = 1000 * (xyz_m[person, column] @ first.rotation.T + first.translation_m)
                points = np.concatenate([of_first_mm, of_first_mm[-2:]])
                people.append(
                    {
                        "id": str(len(people)),
                        "person_id": person,
                        "ref_camera": 0,
                        "image_ids": name,
                        "keypoints3D": np.concatenate([points, np.full((12, 1), 2.0)], axis=1).ravel().tolist(),
                    }
                )
    skeleton = {"name": "person", "id": "1", "keypoints": list(JOINTS)}
    return {
        "images": images,
        "multiview_images": instants,
        "categories": [skeleton],
        "cameras_info": cameras_info(simulation.cameras),
        "annotations": annotations,
        "annotations3D": people,
    }


def mvor_keypoints(simulation: Simulation, document: dict[str, Any], frames: Sequence[int]) -> list[dict[str, Any]]:
    """Detections at the frames in the form of COCO's results."""
    people = []
    for instant, frame in zip(document["multiview_images"], frames, strict=True):
        for image, camera in zip(instant["images"], simulation.cameras, strict=True):
            detections = simulation.detections[camera.name]
            for row in (detections.frame == frame).nonzero()[0]:
                points = np.concatenate([detections.keypoints_px[row], detections.score[row][:, None]], axis=1)
                keypoints = np.nan_to_num(points).ravel().tolist()
                people.append({"image_id": image["id"], "category_id": "1", "coco_keypoints": keypoints, "score": 0.9})
    return people


def write_json(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def write_mvor(folder: Path, document: dict[str, Any]) -> Path:
    """Write annotations as the repository has them."""
    write_json(folder / "annotations" / ANNOTATIONS, document)
    return folder
