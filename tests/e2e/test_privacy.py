"""Privacy of a real job, by the workers of a real service: heads are gone from all pictures, then the videos are."""

import base64
import io
import json
import re
from collections.abc import Iterator
from contextlib import ExitStack

import av
import cv2
import numpy as np
import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served
from tests.waiting import wait_for

pytestmark = [pytest.mark.xdist_group("sample"), pytest.mark.slow]

SPEC = {"profile": "fast", "report": True, "overlay": True, "blur_faces": True, "keep_videos": False}
FRAMES = [0, 14]


def post(served: Served, sample: Sample) -> dict[str, str]:
    with ExitStack() as opened:
        files = [("videos", (path.name, opened.enter_context(path.open("rb")))) for path in sample.videos.values()]
        calibration = ("calibration", (sample.calibration.name, sample.calibration.read_bytes()))
        spec = ("spec", (None, json.dumps(SPEC | {"frame_range": FRAMES}).encode()))
        answer = served.client.post("/v1/jobs", files=[*files, calibration, spec], timeout=120)
    assert answer.status_code == 202, answer.text
    return dict(answer.json())


def pictures(video: bytes) -> Iterator[np.ndarray]:
    with av.open(io.BytesIO(video), "r") as opened:
        for frame in opened.decode(video=0):
            yield frame.to_ndarray(format="rgb24")


def detail(image: np.ndarray) -> float:
    """Mean energy of all that is finer than an eighth of a head."""
    coarse = cv2.GaussianBlur(image.astype(float), (0, 0), max(1.0, min(image.shape[:2]) / 16))
    return float(np.mean((image - coarse) ** 2))


def noses(served: Served, job_id: str) -> dict[str, list[tuple[float, float]]]:
    """Places of noses in the first frame, by camera, as parts of width and height."""
    skeletons = served.client.get(f"/v1/jobs/{job_id}/motion/description").raise_for_status().json()
    document = served.client.get(f"/v1/jobs/{job_id}/results/skeletons.json").raise_for_status().json()
    nose = document["joint_names"].index("nose")
    found: dict[str, list[tuple[float, float]]] = {}
    for camera in skeletons["cameras"]:
        rotation = np.array(camera["cam_from_world"]["rotation"])
        translation_m = np.array(camera["cam_from_world"]["translation_m"])
        for person in document["tracks"]:
            if person["start_frame"] > 0 or person["positions_m"][0][nose] is None:
                continue
            in_cam = rotation @ np.array(person["positions_m"][0][nose], float) + translation_m
            x, y, _ = np.array(camera["matrix"]) @ (in_cam / in_cam[2])
            width, height = camera["size_px"]
            if 0.05 < x / width < 0.95 and 0.05 < y / height < 0.95:
                found.setdefault(camera["name"], []).append((x / width, y / height))
    return found


def test_heads_are_gone_and_then_videos(served: Served, sample: Sample) -> None:
    job = post(served, sample)
    job_id, address = job["id"], f"/v1/sessions/{job['session_id']}"
    link = served.client.post(f"/v1/jobs/{job_id}/links", json={"scope": "job"}).raise_for_status().json()["url"]
    secret = {"link": link.partition("link=")[2]}
    for name in sample.videos:
        assert served.client.get(f"{address}/videos/{name}", params=secret).status_code == 409
    ended = served.wait_for_end(job_id)
    assert ended["state"] == "succeeded", ended["error"]

    listed = served.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
    assert sum(file["kind"] == "blurred" for file in listed) == len(sample.videos)
    found = noses(served, job_id)
    assert sum(map(len, found.values())) >= 3
    for name, path in sample.videos.items():
        original = next(pictures(path.read_bytes()))
        shown = served.client.get(f"{address}/videos/{name}", params=secret).raise_for_status().content
        overlay = served.client.get(f"/v1/jobs/{job_id}/results/overlay-{name}.mp4").raise_for_status().content
        blurred, drawn = next(pictures(shown)), next(pictures(overlay))
        for x, y in found.get(name, ()):
            for picture in (blurred, drawn):
                height, width = picture.shape[:2]
                small = cv2.resize(original, (width, height), interpolation=cv2.INTER_AREA)
                radius_px = round(0.012 * max(width, height))
                rows, columns = (
                    slice(round(part * side) - radius_px, round(part * side) + radius_px + 1)
                    for part, side in ((y, height), (x, width))
                )
                if picture is blurred:
                    assert detail(picture[rows, columns]) < 0.2 * detail(small[rows, columns]) + 2.0
    report = served.client.get(f"/v1/jobs/{job_id}/results/report.html").raise_for_status().text
    jpegs = [base64.b64decode(text) for text in re.findall(r"data:image/jpeg;base64,([A-Za-z0-9+/=]+)", report)]
    assert len(jpegs) >= len(sample.videos)

    wait_for(lambda: served.client.get(address).json()["videos_deleted_at"] is not None, timeout_s=60)
    inputs = served.data_dir / "artifacts" / "sessions" / job["session_id"] / "inputs"
    wait_for(lambda: not [path for path in inputs.iterdir() if path.suffix == ".mp4"], timeout_s=60)
    for name in sample.videos:
        assert served.client.get(f"{address}/videos/{name}", params=secret).status_code == 200
        assert served.client.get(f"{address}/thumbnails/{name}/0", params=secret).status_code == 404

    people = served.edits(job_id)["run"]["found"]
    served.edit(job_id, {"action": "rename", "person": people[0]["id"], "name": "Anna"})
    edited = served.wait_for_end(job_id)
    assert (edited["state"], edited["results_revision"]) == ("succeeded", 1)
    again = served.client.post(f"{address}/jobs", json={"profile": "fast", "exports": ["csv"], "frame_range": FRAMES})
    assert served.wait_for_end(again.raise_for_status().json()["id"])["state"] == "succeeded"
    refused = served.client.post(f"{address}/jobs", json={"profile": "balanced"})
    assert (refused.status_code, refused.json()["code"]) == (409, "videos_deleted")
