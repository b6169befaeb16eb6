"""Triangulate by a program that reads its own format: ``PROGRAM CALIBRATION PIXELS OUT``.

PIXELS is JSON: pixels of points by camera, in the order of the rig. OUT gets the names of the cameras in the order in
which the program has them, and the points in metres.
"""

import json
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

Result = tuple[list[str], np.ndarray]


def by_aniposelib(path: Path, pixels: np.ndarray) -> Result:
    """Load and triangulate by aniposelib; its bundle adjustment starts with the parameters of each camera."""
    from aniposelib.cameras import CameraGroup  # noqa: PLC0415 - each program alone

    group = CameraGroup.load(str(path))
    for camera in group.cameras:
        assert np.isfinite(camera.get_params()).all()
    return group.get_names(), group.triangulate(pixels)


def by_caliscope(path: Path, pixels: np.ndarray) -> Result:
    """Load and undistort by Caliscope, which knows cameras by their numbers."""
    from caliscope.api import CameraArray  # noqa: PLC0415 - each program alone

    array = CameraArray.from_toml(path)
    cameras = [array.cameras[number] for number in sorted(array.cameras)]
    assert len(array.posed_cameras) == len(cameras)
    rays = [camera.undistort_points(seen, output="normalized") for camera, seen in zip(cameras, pixels, strict=True)]
    names = [str(number) for number in sorted(array.cameras)]
    return names, crossing([camera.normalized_projection_matrix for camera in cameras], rays)


def by_opencv(path: Path, pixels: np.ndarray) -> Result:
    """Load by OpenCV's FileStorage, with each node that a camera needs."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    names, projections, rays = [], [], []
    for key, seen in zip(storage.root().keys(), pixels, strict=True):
        node = storage.getNode(key)
        names.append(node.getNode("name").string() or key)
        matrix, distortion, rvec, tvec = (
            node.getNode(field).mat() for field in ("camera_matrix", "distortion_coefficients", "rvec", "tvec")
        )
        assert node.getNode("image_width").real() > 0
        is_fisheye = node.getNode("camera_model").string() == "fisheye"
        undistort = cv2.fisheye.undistortPoints if is_fisheye else cv2.undistortPoints
        rays.append(undistort(seen.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2))
        projections.append(np.hstack([cv2.Rodrigues(rvec)[0], tvec.reshape(3, 1)]))
    return names, crossing(projections, rays)


def by_freemocap(path: Path, pixels: np.ndarray) -> Result:
    """Load and triangulate by aniposelib, of which FreeMoCap's reader is a copy; lengths are millimetres."""
    names, points_mm = by_aniposelib(path, pixels)
    return names, points_mm / 1000


def by_colmap(path: Path, pixels: np.ndarray) -> Result:
    """Load by COLMAP itself, whose pixels begin at the outer corner of the first one."""
    import pycolmap  # noqa: PLC0415 - each program alone

    folder = path.with_suffix("")
    zipfile.ZipFile(path).extractall(folder)
    model = pycolmap.Reconstruction(str(folder))
    images = [model.images[number] for number in sorted(model.images)]
    rays = [image.camera.cam_from_img(seen + 0.5) for image, seen in zip(images, pixels, strict=True)]
    projections = [image.cam_from_world().matrix() for image in images]
    return [Path(image.name).stem for image in images], crossing(projections, rays)


def crossing(projections: Sequence[np.ndarray], rays: Sequence[np.ndarray]) -> np.ndarray:
    """Points nearest to the rays of all cameras, by linear least squares."""
    rows = [ray[:, :, None] * projection[2] - projection[:2] for projection, ray in zip(projections, rays, strict=True)]
    points = np.linalg.svd(np.concatenate(rows, axis=1))[2][:, -1]
    return points[:, :3] / points[:, 3:]


PROGRAMS: dict[str, Callable[[Path, np.ndarray], Result]] = {
    "anipose": by_aniposelib,
    "caliscope": by_caliscope,
    "opencv": by_opencv,
    "freemocap": by_freemocap,
    "colmap": by_colmap,
}

if __name__ == "__main__":
    program, calibration, source, out = sys.argv[1:]
    names, points_m = PROGRAMS[program](Path(calibration), np.array(json.loads(Path(source).read_text())))
    Path(out).write_text(json.dumps({"names": names, "points_m": np.asarray(points_m).tolist()}))
