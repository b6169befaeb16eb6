"""Speed and error beside aniposelib, Pose2Sim and MediaPipe's Pose on the same input; `make verify-speed` runs it.

The programs take turns, and medians of their times are printed: other work on the machine slows all of them.

``MULTICAP_RENDERED`` names a folder of a rendered capture, as `multicap evaluate rendered --data` reads it. Without it
people are simulated, and MediaPipe is not compared.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.calibration.write import encode_toml
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig, Smoothing
from pipeline.detection import models
from pipeline.detection.entries import detection_joints
from pipeline.detection.profiles.profile_detector import open_detection
from pipeline.geometry.camera import project, projection_matrices
from pipeline.geometry.tracks import triangulate_frames
from pipeline.geometry.undistortion import undistort_views
from pipeline.run.engine.local import detect_people, reconstruct
from pipeline.run.warm_up import warm_up
from pipeline.validation.evaluation.datasets.rendered import RenderedTruth, load_rendered, score_rendered
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, GATE_M, accuracy
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Clock, Layout, Rig
from pipeline.validation.simulation.scenes import Scene, Simulation, find_scene, record, simulation_files

PEERS = Path(__file__).parents[3] / ".venv-speed"
ANIPOSE = Path(__file__).parents[3] / ".venv-peers"
RUNNERS = Path(__file__).parent / "peers"
RENDERED = os.environ.get("MULTICAP_RENDERED") or None
CONFIG = ReconstructionConfig(profile="balanced", joints="body", joint_centers="off", force=True)
# Landmarks of MediaPipe's Pose that are the joints of COCO-17, and joints of COCO-17 by Pose2Sim's names.
LANDMARKS = [0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28]
PARTS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
# Share of a window's size that it is larger than the person on each side.
MARGIN = 0.2
# Least score of a joint that is triangulated.
MIN_SCORE = 0.1
# One picture in so many is timed.
TIMED_STEP = 4
TURNS = 3

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all((folder / ".installed").is_file() for folder in (PEERS, ANIPOSE)),
        reason="MediaPipe, Pose2Sim and aniposelib are not installed (`make verify-speed`)",
    ),
]


@dataclass(frozen=True, slots=True)
class SpeedAndError:
    """Seconds of a core for a camera frame, and error."""

    core_ms: float
    mpjpe_mm: float
    recall: float

    def tell(self, name: str) -> None:
        sys.stdout.write(
            f"{name}: {self.core_ms:.2f} ms a camera frame, {self.mpjpe_mm:.1f} mm, recall {self.recall:.3f}\n"
        )


def core_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def median_of(turns: Sequence[SpeedAndError]) -> SpeedAndError:
    """Median time; all turns have the same error."""
    return replace(turns[0], core_ms=float(np.median([turn.core_ms for turn in turns])))


def run_peer(name: str, *arguments: str, environment: Path = PEERS) -> None:
    program = [str(environment / "bin" / "python"), "-P", str(RUNNERS / f"run_{name}.py"), *arguments]
    done = subprocess.run(program, check=False, timeout=1200, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


def write_keypoints(folder: Path, detections: Mapping[str, Detections], num_frames: Mapping[str, int]) -> None:
    """Write bodies as OpenPose does, with zeros for joints that were not found."""
    for camera, bodies in detections.items():
        rows = np.nan_to_num(np.dstack([bodies.keypoints_px, bodies.score])).reshape(len(bodies.frame), -1)
        (folder / camera).mkdir(parents=True)
        for frame in range(num_frames[camera]):
            people = [{"pose_keypoints_2d": row.tolist()} for row in rows[bodies.frame == frame]]
            path = folder / camera / f"frame_{frame:012d}_keypoints.json"
            path.write_text(json.dumps({"version": 1.3, "people": people}))


def keypoints_of_room(folder: Path) -> RenderedTruth:
    """Keypoint files of simulated people, and their truth."""
    simulation = record(replace(find_scene("room"), duration_s=8.0), seed=0)
    for name, content in simulation_files(simulation):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    (folder / "calibration.toml").write_bytes(encode_toml(simulation.cameras))
    frames = np.arange(simulation.timebase.num_frames)
    return RenderedTruth(COCO_17.names, frames / simulation.timebase.frame_rate_hz, simulation.truth_m)


def keypoints_of_videos(folder: Path, data: Path) -> RenderedTruth:
    """Keypoint files of people whom the networks of `balanced` find, and their truth."""
    models.install_networks(CONFIG)
    session = open_session(data / "videos", data / "calibration.toml")
    num_frames = {name: len(times.time_s) for name, times in session.times.items()}
    write_keypoints(folder / "keypoints", detect_people(session, CONFIG), num_frames)
    (folder / "calibration.toml").write_bytes(encode_toml(session.cameras))
    return load_rendered(data)


def ours(folder: Path, rate_hz: float, smoothing: Smoothing, truth: RenderedTruth) -> SpeedAndError:
    """Reconstruct the files of keypoints here."""
    config = ReconstructionConfig(smoothing=smoothing, joint_centers="off", force=True)
    started_s = core_s()
    session = open_keypoints(folder / "keypoints", folder / "calibration.toml", frame_rate_hz=rate_hz)
    found = reconstruct(session, config)
    spent_s = core_s() - started_s
    scores = score_rendered(found.tracks, found.joints, found.timebase, truth)
    return SpeedAndError(1e3 * spent_s / num_camera_frames(session), scores["mpjpe_mm"], scores["recall"])


def num_camera_frames(session: KeypointSession | CaptureSession) -> int:
    return sum(len(times.time_s) for times in session.times.values())


def pose2sim(given: Path, folder: Path, rate_hz: float, num_frames: int, truth: RenderedTruth) -> SpeedAndError:
    """Reconstruct files of keypoints by Pose2Sim's association and triangulation, in a new folder."""
    (folder / "calibration").mkdir(parents=True)
    (folder / "Config.toml").touch()
    shutil.copy(given / "calibration.toml", folder / "calibration" / "Calib.toml")
    for camera in sorted((given / "keypoints").iterdir()):
        shutil.copytree(camera, folder / "pose" / f"{camera.name}_json")
    run_peer("pose2sim", str(folder), str(folder / "found.npz"), str(rate_hz))
    with np.load(folder / "found.npz") as found:
        names = [f"{side}_{part.lower()}" for part in PARTS for side in ("left", "right")]
        columns = [
            found["names"].tolist().index(f"{side}{part}") for part in PARTS for side in ("L", "R")
        ]  # the package's names
        assert sorted(names) == sorted(BODY_JOINTS)
        people = sum(name.startswith("xyz_m_") for name in found.files)
        predicted_m = np.full((people, len(truth.time_s), len(names), 3), np.nan)
        for person in range(people):
            frames = found[f"frames_{person}"]
            rows = frames < len(truth.time_s)
            predicted_m[person, frames[rows]] = found[f"xyz_m_{person}"][rows][:, columns]
        spent_s = float(found["core_s"])
    true_m = truth.xyz_m[:, :, [truth.names.index(name) for name in names]]
    scores = accuracy(predicted_m, true_m, GATE_M)
    assert scores.mpjpe_mm is not None
    assert scores.recall is not None
    return SpeedAndError(1e3 * spent_s / num_frames, scores.mpjpe_mm, scores.recall)


@pytest.mark.parametrize("source", ["simulated", "rendered"])
def test_association_and_triangulation_beside_pose2sim(source: str, tmp_path: Path) -> None:
    if source == "rendered" and RENDERED is None:
        pytest.skip("MULTICAP_RENDERED names no rendered capture")
    truth = keypoints_of_room(tmp_path) if RENDERED is None or source == "simulated" else None
    truth = truth or keypoints_of_videos(tmp_path, Path(str(RENDERED)))
    rate_hz = float(1 / np.median(np.diff(truth.time_s)))
    warm_up()
    num_frames = sum(1 for _ in (tmp_path / "keypoints").glob("*/*.json"))
    turns = [
        (
            ours(tmp_path, rate_hz, "none", truth),
            ours(tmp_path, rate_hz, "fit", truth),
            pose2sim(tmp_path, tmp_path / f"pose2sim_{turn}", rate_hz, num_frames, truth),
        )
        for turn in range(TURNS)
    ]
    located, fitted, peer = map(median_of, zip(*turns, strict=True))
    sys.stdout.write(f"\n{source} people, {num_frames} camera frames of keypoints:\n")
    located.tell("association and triangulation")
    fitted.tell("with the fit")
    peer.tell("Pose2Sim")
    for product in (located, fitted):
        assert product.mpjpe_mm < peer.mpjpe_mm
        assert product.recall >= peer.recall


def points_of_people(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Points and scores of each person, by the truth: people, frames, cameras, joints; NaN and 0 where unseen."""
    people, frames, joints = simulation.truth_m.shape[:3]
    points_px = np.full((people, frames, len(simulation.cameras), joints, 2), np.nan)
    score = np.zeros(points_px.shape[:-1])
    for number, camera in enumerate(simulation.cameras):
        bodies, person = simulation.detections[camera.name], simulation.identities[camera.name]
        rows = np.flatnonzero(person >= 0)
        at = person[rows], bodies.frame[rows], number
        is_seen = bodies.score[rows] >= MIN_SCORE
        points_px[at] = np.where(is_seen[..., None], bodies.keypoints_px[rows], np.nan)
        score[at] = np.where(is_seen, bodies.score[rows], 0.0)
    return points_px, score


def test_triangulation_beside_aniposelib(tmp_path: Path) -> None:
    """The people are known by the truth, so that only triangulation is compared, each time with undistortion."""
    simulation = record(
        Scene(Rig(Layout.RING, 4, (6.0, 5.0), 2.6), Cast(3, (6.0, 5.0)), Clock(25.0), duration_s=8.0), seed=0
    )
    points_px, score = points_of_people(simulation)
    by_camera = np.moveaxis(points_px, 2, 0).reshape(len(simulation.cameras), -1, 2)
    (tmp_path / "calibration.toml").write_bytes(encode_toml(simulation.cameras))
    np.save(tmp_path / "points.npy", by_camera)
    files = [str(tmp_path / name) for name in ("calibration.toml", "points.npy", "found.npz")]
    warm_up()
    core: dict[str, list[float]] = {name: [] for name in ("product", "aniposelib", "aniposelib, fast")}
    xyz_m: dict[str, np.ndarray] = {}
    for _ in range(TURNS):
        started_s = core_s()
        xyz_m["product"] = np.array(
            [
                triangulate_frames(
                    projection_matrices(simulation.cameras), undistort_views(simulation.cameras, own_px), own_score
                )
                for own_px, own_score in zip(points_px, score, strict=True)
            ]
        )
        core["product"].append(core_s() - started_s)
        run_peer("aniposelib", *files, environment=ANIPOSE)
        with np.load(files[-1]) as found:
            for name, key in (("aniposelib", "all"), ("aniposelib, fast", "fast")):
                xyz_m[name] = found[f"xyz_m_{key}"].reshape(simulation.truth_m.shape)
                core[name].append(float(found[f"core_s_{key}"]))
    is_located = np.all([np.isfinite(found_m).all(-1) for found_m in (*xyz_m.values(), simulation.truth_m)], axis=0)
    apart_mm = {
        name: 1e3 * np.linalg.norm(found_m - simulation.truth_m, axis=-1)[is_located].mean()
        for name, found_m in xyz_m.items()
    }
    num_bodies = int(np.isfinite(points_px).any((2, 3, 4)).sum())
    sys.stdout.write(f"\ntriangulation of {num_bodies} bodies in {len(simulation.cameras)} cameras:\n")
    for name, spent_s in core.items():
        sys.stdout.write(f"{name}: {num_bodies / np.median(spent_s):,.0f} bodies a second, {apart_mm[name]:.1f} mm\n")
    assert is_located.mean() > 0.9
    assert apart_mm["product"] < min(apart_mm["aniposelib"], apart_mm["aniposelib, fast"])


def windows(session: CaptureSession, truth: RenderedTruth) -> dict[str, list[list[int]]]:
    """Window of each person in each camera, around all places in which the person is."""
    boxes: dict[str, list[list[int]]] = {}
    for camera in session.cameras:
        boxes[camera.name] = []
        for person_m in truth.xyz_m:
            points_px = project(camera, person_m.reshape(-1, 3))
            low_px, high_px = np.nanmin(points_px, axis=0), np.nanmax(points_px, axis=0)
            margin_px = MARGIN * (high_px - low_px)
            left, top = np.clip(low_px - margin_px, 0, None).astype(int).tolist()
            right, bottom = np.minimum(high_px + margin_px, camera.size_px).astype(int).tolist()
            boxes[camera.name].append([left, top, right, bottom])
    return boxes


def bodies_of(camera: str, found: np.ndarray) -> Detections:
    """Bodies of all windows of a camera, with the joints of COCO-17."""
    people, frames = np.nonzero(np.isfinite(found).all((2, 3)))
    order = np.argsort(frames, kind="stable")
    marks = found[people[order], frames[order]][:, LANDMARKS]
    points_px = marks[..., :2]
    boxes_px = np.concatenate([points_px.min(1), points_px.max(1)], axis=1)
    return Detections(camera, frames[order], points_px, marks[..., 2], boxes_px)


def located(session: CaptureSession, detections: Mapping[str, Detections], truth: RenderedTruth) -> tuple[float, float]:
    """Error and recall of people who are reconstructed from detections."""
    rate_hz = session.timebase.frame_rate_hz
    timebase = Timebase(0.0, rate_hz, session.timebase.num_frames)
    keypoints = KeypointSession(
        session.cameras, session.times, timebase, detections, detection_joints(CONFIG), folders={}, findings=()
    )
    found = reconstruct(keypoints, ReconstructionConfig(smoothing="none", joint_centers="off", force=True))
    scores = score_rendered(found.tracks, found.joints, found.timebase, truth)
    return scores["mpjpe_mm"], scores["recall"]


def detection_ms(videos: Path, cameras: list[str]) -> float:
    """Milliseconds of a core for a picture in the networks of `balanced`, from picture to joints of everybody."""
    detector = open_detection(CONFIG.networks, CONFIG.detected_joints)
    total_s, num_pictures = 0.0, 0
    for camera in cameras:
        with av.open(str(videos / f"{camera}.mp4")) as container:
            pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)][::TIMED_STEP]
        detector.detect(pictures[0])
        started_s = core_s()
        for picture in pictures:
            detector.detect(picture)
        total_s, num_pictures = total_s + core_s() - started_s, num_pictures + len(pictures)
    return 1e3 * total_s / num_pictures


def test_joints_beside_mediapipe(tmp_path: Path) -> None:
    """MediaPipe gets a window around each person from the truth: it finds one person; Multicap gets whole pictures."""
    if RENDERED is None:
        pytest.skip("MULTICAP_RENDERED names no rendered capture")
    data = Path(RENDERED)
    models.install_networks(CONFIG)
    truth, session = load_rendered(data), open_session(data / "videos", data / "calibration.toml")
    cameras = [camera.name for camera in session.cameras]
    (tmp_path / "windows.json").write_text(json.dumps(windows(session, truth)))
    warm_up()
    spent_ms: list[tuple[float, float]] = []
    for _ in range(TURNS):
        run_peer("mediapipe", str(data / "videos"), str(tmp_path / "windows.json"), str(tmp_path / "found.npz"))
        with np.load(tmp_path / "found.npz") as found:
            peer_ms = 1e3 * float(found["core_s"]) / num_camera_frames(session)
            of_peer = {camera: bodies_of(camera, found[camera]) for camera in cameras}
        spent_ms.append((detection_ms(data / "videos", cameras), peer_ms))
    own_ms, peer_ms = np.median(spent_ms, axis=0).tolist()
    peer = SpeedAndError(peer_ms, *located(session, of_peer, truth))
    measured = SpeedAndError(own_ms, *located(session, detect_people(session, CONFIG), truth))
    sys.stdout.write(f"\nrendered people, {num_camera_frames(session)} camera frames, {len(truth.xyz_m)} people:\n")
    measured.tell("profile balanced, whole pictures")
    peer.tell("MediaPipe's Pose, a window for each person")
    assert measured.mpjpe_mm < peer.mpjpe_mm
    assert measured.recall >= peer.recall
