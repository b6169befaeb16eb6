"""Keypoint files as other programs write them, from simulated detections of COCO's 17 joints."""

import csv
import io
import json
import pickle
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.joints import BODY_25, COCO_17, COCO_18
from pipeline.core.layouts import LAYOUTS
from pipeline.validation.simulation.scenes import Simulation, simulation_files

Files = dict[str, bytes]
Frames = Mapping[int, list[np.ndarray]]
"""Joints of each person of each frame: x, y and score, 0 where they are undetected."""


def frames_of(detections: Detections, num_frames: int) -> Frames:
    points = np.concatenate([detections.keypoints_px, detections.score[..., None]], axis=-1)
    points = np.where(np.isfinite(points).all(-1, keepdims=True), points, 0.0)
    return {frame: list(points[detections.frame == frame]) for frame in range(num_frames)}


def _flat(person: np.ndarray) -> list[float]:
    return [float(value) for value in person.ravel()]


def _people(frames: Frames) -> Iterator[tuple[int, np.ndarray]]:
    for number, people in frames.items():
        for person in people:
            yield number, person


def alphapose(frames: Frames, camera: Camera) -> Files:
    listed = [
        {"image_id": f"{number}.jpg", "category_id": 1, "keypoints": _flat(person), "score": 2.9, "box": [1.0] * 4}
        for number, person in _people(frames)
    ]
    return {"alphapose-results.json": json.dumps(listed).encode()}


def alphapose_like_openpose(frames: Frames, camera: Camera) -> Files:
    """With ``--format open``: 18 joints, among them the neck."""

    def body(person: np.ndarray) -> list[float]:
        neck = person[COCO_17.indices(("left_shoulder", "right_shoulder"))].mean(0)
        by_name = dict(zip(COCO_17.names, person, strict=True)) | {"neck": neck}
        return _flat(np.array([by_name[name] for name in COCO_18.names]))

    images = {
        f"{number}.jpg": {"version": "AlphaPose v0.3", "people": [{"pose_keypoints_2d": body(one)} for one in people]}
        for number, people in frames.items()
    }
    return {"alphapose-results.json": json.dumps(images).encode()}


def poseflow(frames: Frames, camera: Camera) -> Files:
    """Tracked people of each image; PoseFlow writes the scores of boxes as ``scores``."""
    images = {
        f"frame_{number:06d}.jpg": [
            {"keypoints": _flat(person), "scores": 2.9, "idx": k + 1} for k, person in enumerate(people)
        ]
        for number, people in frames.items()
    }
    return {"alphapose-results-forvis-tracked.json": json.dumps(images).encode()}


def easymocap(frames: Frames, camera: Camera) -> Files:
    """A file a frame, with the points of COCO in the order of BODY_25."""

    def body(person: np.ndarray) -> list[list[float]]:
        by_name = dict(zip(COCO_17.names, person, strict=True))
        for name, part in (("neck", "shoulder"), ("mid_hip", "hip")):
            by_name[name] = (by_name[f"left_{part}"] + by_name[f"right_{part}"]) / 2
        return [by_name.get(name, np.array([0.0, 0.0, -1.0])).tolist() for name in BODY_25.names]

    return {
        f"{number:06d}.json": json.dumps(
            {
                "filename": f"images/{camera.name}/{number:06d}.jpg",
                "height": camera.size_px[1],
                "width": camera.size_px[0],
                "annots": [
                    {"personID": k, "bbox": [1.0, 2.0, 3.0, 4.0, 0.9], "keypoints": body(person), "isKeyframe": False}
                    for k, person in enumerate(people)
                ],
                "isKeyframe": False,
            }
        ).encode()
        for number, people in frames.items()
    }


def _instances(people: list[np.ndarray]) -> list[dict[str, Any]]:
    return [
        {
            "keypoints": person[:, :2].tolist(),
            "keypoint_scores": person[:, 2].tolist(),
            "bbox": [[1.0, 2.0, 3.0, 4.0]],
            "bbox_score": 0.9,
        }
        for person in people
    ]


def mmpose_inferencer(frames: Frames, camera: Camera) -> Files:
    listed = [{"frame_id": number, "instances": _instances(people)} for number, people in frames.items()]
    return {f"{camera.name}.json": json.dumps(listed).encode()}


def mmpose_images(frames: Frames, camera: Camera) -> Files:
    """Of the inferencer on a folder of images: a file an image."""
    return {f"{number:06d}.json": json.dumps(_instances(people)).encode() for number, people in frames.items()}


def mmpose_demo(frames: Frames, camera: Camera) -> Files:
    listed = [{"frame_id": number, "instances": _instances(people)} for number, people in frames.items()]
    names = {str(k): name for k, name in enumerate(COCO_17.names)}
    meta = {"dataset_name": "coco", "num_keypoints": 17, "keypoint_id2name": names}
    return {f"results_{camera.name}.json": json.dumps({"meta_info": meta, "instance_info": listed}).encode()}


def coco_results(frames: Frames, camera: Camera) -> Files:
    listed = [
        {"image_id": number, "category_id": 1, "keypoints": _flat(person), "score": 0.9}
        for number, person in _people(frames)
    ]
    return {"person_keypoints_results.json": json.dumps(listed).encode()}


def coco_annotations(frames: Frames, camera: Camera) -> Files:
    """Images have ids of the whole data set; the names of their files have the numbers of the frames."""
    first = 7000
    document = {
        "images": [
            {"id": first + number, "file_name": f"{camera.name}/frame_{number:06d}.png", "width": 1920, "height": 1080}
            for number in frames
        ],
        "categories": [{"id": 3, "name": "person", "keypoints": list(COCO_17.names), "skeleton": []}],
        "annotations": [
            {"id": k, "image_id": first + number, "category_id": 3, "num_keypoints": 17, "keypoints": _flat(person)}
            for k, (number, person) in enumerate(_people(frames))
        ],
    }
    return {"instances_default.json": json.dumps(document).encode()}


def deeplabcut(frames: Frames, camera: Camera) -> Files:
    """Of several people: four rows of headers."""
    num_people = max(map(len, frames.values()))
    people = [f"individual{k + 1}" for k in range(num_people)]
    columns = [(one, part, coord) for one in people for part in COCO_17.names for coord in ("x", "y", "likelihood")]
    content = io.StringIO()
    rows = csv.writer(content)
    rows.writerow(["scorer", *["DLC_resnet50_people"] * len(columns)])
    for row, name in enumerate(("individuals", "bodyparts", "coords")):
        rows.writerow([name, *(column[row] for column in columns)])
    for number, seen in frames.items():
        cells = [value for person in seen for value in _flat(person)]
        rows.writerow([number, *cells, *[""] * (len(columns) - len(cells))])
    name = f"{camera.name}DLC_resnet50_peopleshuffle1_100000_el.csv"
    return {name: content.getvalue().encode()}


def _columns(frames: Frames) -> tuple[list[tuple[str, str, str, str]], np.ndarray]:
    """Labels of DeepLabCut's columns, and a row a frame."""
    people = [f"individual{k + 1}" for k in range(max(map(len, frames.values())))]
    coords = ("x", "y", "likelihood")
    columns = [("DLC", person, part, coord) for person in people for part in COCO_17.names for coord in coords]
    rows = np.full((len(frames), len(columns)), np.nan)
    for row, seen in zip(rows, frames.values(), strict=True):
        cells = [value for person in seen for value in _flat(person)]
        row[: len(cells)] = cells
    return columns, rows


def deeplabcut_hdf5(frames: Frames, camera: Camera) -> Files:
    """Table that pandas writes by PyTables: labels of columns are a pickle in an attribute."""
    columns, rows = _columns(frames)
    table = np.zeros(len(rows), [("index", "<i8"), ("values_block_0", "<f8", (len(columns),))])
    table["index"], table["values_block_0"] = list(frames), rows
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_("frame_table")
        stored = group.create_dataset("table", data=table, chunks=(7,), compression="gzip", shuffle=True)
        stored.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns, 0))
    return {f"{camera.name}DLC_resnet50_peopleshuffle1_100000_el.h5": content.getvalue()}


def deeplabcut_hdf5_fixed(frames: Frames, camera: Camera) -> Files:
    """Of labelled pictures, in the form that pandas calls fixed: rows are paths of pictures in three levels."""
    columns, rows = _columns(frames)
    pictures = [("labeled-data", camera.name, f"img{number:04d}.png") for number in frames]
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_("frame")
        group.attrs["nblocks"] = 1
        group["block0_values"] = rows
        for axis, labels in (("block0_items", columns), ("axis1", pictures)):
            for level, of_level in enumerate(zip(*labels, strict=True)):
                known = sorted(set(of_level))
                group[f"{axis}_level{level}"] = np.array(known, "S")
                group[f"{axis}_label{level}"] = np.array([known.index(label) for label in of_level], "i1")
    return {"CollectedData_us.h5": content.getvalue()}


def sleap(frames: Frames, camera: Camera) -> Files:
    """Analysis file; points that were not found are NaN, and have no score."""
    num_people = max(map(len, frames.values()))
    people = np.full((len(frames), num_people, len(COCO_17.names), 3), np.nan)
    for row, seen in zip(people, frames.values(), strict=True):
        row[: len(seen)] = np.reshape(seen, (-1, len(COCO_17.names), 3))
    people[people[..., 2] == 0] = np.nan
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.create_dataset("tracks", data=people[..., :2].transpose(1, 3, 2, 0), compression="gzip")
        file.create_dataset("point_scores", data=people[..., 2].transpose(1, 2, 0), compression="gzip")
        file.create_dataset("track_occupancy", data=np.isfinite(people[..., 0]).any(-1).astype("u1"))
        file["node_names"] = np.array(COCO_17.names, "S")
        file["track_names"] = np.array([f"track_{k}" for k in range(num_people)], "S")
        file["video_path"] = f"{camera.name}.mp4"
    return {f"labels.v001.000_{camera.name}.analysis.h5": content.getvalue()}


def mediapipe_results(frames: Frames, camera: Camera) -> Files:
    """Results of the task in Python: shares of the image."""
    points = LAYOUTS["mediapipe-33"].points

    def landmarks(person: np.ndarray) -> list[dict[str, float]]:
        by_name = dict(zip(COCO_17.names, person, strict=True))
        found = [by_name.get(str(name), np.zeros(3)) for name in points]
        shares = [((x + 0.5) / camera.size_px[0], (y + 0.5) / camera.size_px[1], score) for x, y, score in found]
        return [{"x": x, "y": y, "z": 0.0, "visibility": score, "presence": score} for x, y, score in shares]

    listed = [
        {"pose_landmarks": [landmarks(person) for person in people], "pose_world_landmarks": []}
        for people in frames.values()
    ]
    return {"landmarks.json": json.dumps(listed).encode()}


def yolo(frames: Frames, camera: Camera) -> Files:
    """Of pictures, tracked: pictures without people have no file."""

    def line(person: np.ndarray, track: int) -> str:
        shares = person / [*camera.size_px, 1.0]
        return " ".join(map(str, [0, 0.5, 0.5, 0.1, 0.2, *_flat(shares), 0.91, track]))

    return {
        f"{camera.name}_{number:06d}.txt": "".join(
            f"{line(person, k + 1)}\n" for k, person in enumerate(people)
        ).encode()
        for number, people in frames.items()
        if people
    }


PROGRAMS: Mapping[str, Callable[[Frames, Camera], Files]] = {
    "AlphaPose": alphapose,
    "AlphaPose, open": alphapose_like_openpose,
    "AlphaPose, PoseFlow": poseflow,
    "EasyMocap": easymocap,
    "MMPose": mmpose_inferencer,
    "MMPose, images": mmpose_images,
    "MMPose, demo": mmpose_demo,
    "COCO": coco_results,
    "COCO, annotations": coco_annotations,
    "DeepLabCut": deeplabcut,
    "DeepLabCut, HDF5": deeplabcut_hdf5,
    "DeepLabCut, HDF5 of pictures": deeplabcut_hdf5_fixed,
    "SLEAP": sleap,
    "MediaPipe": mediapipe_results,
    "YOLO": yolo,
}
"""Writers by the name of the program, and what is special."""


def keypoint_files(simulation: Simulation, program: str) -> dict[str, Files]:
    """Files of each camera."""
    return {
        camera.name: PROGRAMS[program](
            frames_of(simulation.detections[camera.name], len(simulation.times[camera.name].time_s)), camera
        )
        for camera in simulation.cameras
    }


def write_session(simulation: Simulation, program: str, folder: Path) -> None:
    """Write the calibration, the timestamps, and the keypoint files of a program."""
    files = {name: content for name, content in simulation_files(simulation) if not name.startswith("keypoints/")}
    for camera, of_camera in keypoint_files(simulation, program).items():
        files |= {f"keypoints/{camera}/{name}": content for name, content in of_camera.items()}
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def freemocap_array(simulation: Simulation) -> np.ndarray:
    """Array of all cameras, in their natural order, with the first person of each frame."""
    num_frames = min(len(times.time_s) for times in simulation.times.values())
    content = np.full((len(simulation.cameras), num_frames, 17, 3), np.nan)
    for place, camera in enumerate(sorted(simulation.cameras, key=lambda camera: camera.name)):
        detections = simulation.detections[camera.name]
        for frame in range(num_frames):
            rows = np.flatnonzero(detections.frame == frame)
            if len(rows):
                content[place, frame, :, :2] = detections.keypoints_px[rows[0]]
                content[place, frame, :, 2] = np.clip(detections.score[rows[0]], 0, 1)
    return content
