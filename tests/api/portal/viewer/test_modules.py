"""Modules of the viewer without a browser: Node runs the tests in this folder on files of the pipeline."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pipeline.core.data.cameras import Camera, LensModel
from pipeline.core.data.people import Doubt
from pipeline.core.data.rigid import Rigid3
from pipeline.export.character.retarget import retarget
from pipeline.export.character.writers import character_glb
from pipeline.export.character.writers.posed import PosedCharacter
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.viewer.description import ViewerMotion, describe_body, describe_shape
from pipeline.geometry.camera import project
from pipeline.motion.angles.compute import joint_angles, observable_angles
from pipeline.motion.body import installed
from pipeline.motion.body.shape import shape_body
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.model import find_skeleton, forward_kinematics, joint_pose
from tests.api.portal.node import run_by_node
from tests.pipeline.export.character.takes import take_of
from tests.pipeline.export.character.test_retarget import figure
from tests.pipeline.export.quality.test_report import shifted
from tests.pipeline.export.viewer.takes import FOOTAGE, take
from tests.pipeline.export.writers.test_bvh import walk
from tests.pipeline.media import add_sound, write_video
from tests.pipeline.motion.body.conftest import in_pose
from tests.pipeline.motion.skeleton.hands.people import gesturing
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker
from tests.pipeline.video.corpus import write_clip

HERE = Path(__file__).parent
# Clips whose pictures the page decodes itself, and others, which film.test.mjs names.
DECODED = ("h264-b-frames.mp4", "h264-long-gop.mov", "h264-variable.mp4", "h264-late-start.mov", "h264-baseline.m4v")
NOT_DECODED = ("h264-fragmented.mp4", "h264-rotated-90.mp4", "hevc-8.mp4", "mpeg4-b-frames.mp4", "vp9.webm")
LENSES: dict[str, tuple[LensModel, tuple[float, ...]]] = {
    "ideal": ("standard", ()),
    "4 coefficients": ("standard", (-0.28, 0.09, 0.0007, -0.0011)),
    "5 coefficients": ("standard", (-0.31, 0.12, 0.001, 0.002, -0.02)),
    "8 coefficients": ("standard", (0.8, -0.3, 0.001, -0.0005, 0.01, 0.95, -0.2, 0.03)),
    "12 coefficients": ("standard", (-0.2, 0.05, 0.001, 0.001, 0.01, 0.1, 0.02, 0.003, 0.004, -0.002, 0.003, 0.001)),
    "fisheye": ("fisheye", (0.03, -0.004, 0.001, -0.0002)),
    "fisheye whose radius shrinks": ("fisheye", (-0.2, -0.05, 0.0, 0.0)),
}


def lens_cases() -> list[dict[str, Any]]:
    rng = np.random.default_rng(11)
    cases = []
    for name, (lens, distortion) in LENSES.items():
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        matrix = np.array([[1410.0, 2.5, 955.0], [0.0, 1395.0, 545.0], [0.0, 0.0, 1.0]])
        camera = Camera(
            name, (1920, 1080), matrix, np.array(distortion), Rigid3(rotation, rng.normal(size=3)), lens=lens
        )
        points_m = rng.uniform(-6.0, 6.0, (300, 3))
        pixels = project(camera, points_m)
        cases.append(
            {
                "name": name,
                "camera": {
                    "size_px": list(camera.size_px),
                    "matrix": matrix.tolist(),
                    "distortion": list(distortion),
                    "lens": lens,
                    "cam_from_world": {
                        "rotation": rotation.tolist(),
                        "translation_m": camera.cam_from_world.translation_m.tolist(),
                    },
                },
                "points": points_m.tolist(),
                "pixels": [pixel.tolist() if np.isfinite(pixel).all() else None for pixel in pixels],
            }
        )
    return cases


def video_cases(folder: Path) -> dict[str, Any]:
    """Videos in a folder, with the samples that a demultiplexer finds in them."""
    write_video(folder / "keys.mp4", 60, (320, 180), options={"g": "15", "bf": "2", "crf": "12"})
    add_sound(folder / "keys.mp4", folder / "sound.mp4")
    for name in (*DECODED, *NOT_DECODED):
        write_clip(folder, name)
    return {name: samples_of(folder / name) for name in ("keys.mp4", "sound.mp4", *DECODED)}


def samples_of(path: Path) -> dict[str, Any]:
    """Codec of a video, and its samples in the order of decoding."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size]
        order = sorted(range(len(packets)), key=lambda number: packets[number].pts or 0)
        header = bytes(stream.codec_context.extradata or b"")
    return {
        "codec": f"avc1.{header[1:4].hex()}",
        "samples": [
            {"offset": packet.pos, "size": packet.size, "is_key": packet.is_keyframe, "frame": order.index(number)}
            for number, packet in enumerate(packets)
        ],
    }


@pytest.fixture(scope="module")
def fixtures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    row = 15
    gap_m = walker(60) + np.array([1.5, 0.0, 0.0])
    gap_m[row, 9] = np.nan
    reconstruction = take(
        track_of(walker(40)), track_of(gap_m, track_id=4, start_frame=30), doubts=((), (Doubt(45, 0.6, 1),))
    )
    first, second = reconstruction.observations
    unseen = second.score.copy()
    unseen[row, 2] = 0.0
    second = replace(shifted(second, 1, (3.0, 4.0)), score=unseen)
    reconstruction = replace(reconstruction, observations=(first, second))
    motion = ViewerMotion(reconstruction, person_views(reconstruction), FOOTAGE, quality_report(reconstruction))
    (folder / "motion.bin").write_bytes(b"".join(motion.encode()))
    (folder / "motion.json").write_bytes(motion.describe())
    track = reconstruction.tracks[1]
    skeleton_m = forward_kinematics(reconstruction.motions[1])
    expected = {
        "row": row,
        "joints": [xyz.tolist() if np.isfinite(xyz).all() else [None] * 3 for xyz in track.xyz_m[row]],
        "skeleton": skeleton_m[row].tolist(),
        "angles_deg": [
            float(value) if np.isfinite(value) else None
            for value in joint_angles(reconstruction.motions[1], track, reconstruction.joints).angle_deg[
                row, np.isin(ANGLE_NAMES, observable_angles(reconstruction.joints))
            ]
        ],
        "sources": track.source[row].tolist(),
        "views": track.views[row].tolist(),
    }
    (folder / "expected.json").write_text(json.dumps(expected), encoding="utf-8")
    (folder / "lenses.json").write_text(json.dumps(lens_cases()), encoding="utf-8")
    (folder / "videos.json").write_text(json.dumps(video_cases(folder)), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Motions with positions of the face, and everybody's skin in each frame as rotations of the fit bend it."""
    folder = tmp_path_factory.mktemp("bodies")
    installed.install()
    shapes = installed.load().coarse()
    cases = []
    for name, motion in (("walk", walk(40)), ("hands", gesturing(40))):
        skeleton = find_skeleton(len(motion.bone_length_m))
        head_m, head = joint_pose(motion, "Head")
        marks = {"nose": (0.0, -0.11, -0.01), "left_ear": (0.075, 0.0, 0.0), "right_ear": (-0.075, 0.0, 0.0)}
        body = shape_body(shapes, motion.bone_length_m)
        skins_m = [
            in_pose(body, turns, root_m)[0]
            for turns, root_m in zip(motion.parent_from_joint, motion.root_m, strict=True)
        ]
        cases.append(
            {
                "name": name,
                "joint_names": list(marks),
                "skeleton": {"names": [joint.name for joint in skeleton]},
                "body": describe_body(shapes),
                "shape": describe_shape(shapes, motion, None),
                "positions": forward_kinematics(motion).tolist(),
                "marks": np.stack([head_m + head.apply(place) for place in marks.values()], axis=1).tolist(),
                "skins": np.round(skins_m, 5).tolist(),
            }
        )
    (folder / "bodies.json").write_text(json.dumps(cases), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def character(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of a character who walks, from before the walk until after it, far from the world's origin."""
    folder = tmp_path_factory.mktemp("character")
    animation = take_of("walk", "feet", 2.0)
    source = replace(animation.motions[0], start_frame=10)
    frames = range(7, source.frames.stop + 2)
    is_present = np.isin(frames, source.frames)
    motion = retarget(source, figure("mixamo"), animation.floor)
    posed = PosedCharacter(motion, "Ana", frames, is_present, np.array([100.0, -50.0, 0.0]))
    (folder / "character.glb").write_bytes(b"".join(character_glb.encode(posed)))
    held = posed.held()
    expected = {
        "start_frame": 7,
        "rate_hz": source.frame_rate_hz,
        "scale": motion.scale,
        "present": [10, source.frames.stop],
        "hips": posed.hips,
        "places": held.translations(held.hips).tolist(),
        "turning": posed.turning(),
        "quaternions": held.quaternions(posed.turning()[-1]).tolist(),
    }
    (folder / "expected.json").write_text(json.dumps(expected), encoding="utf-8")
    return folder


def test_characters_are_read_from_their_files(character: Path) -> None:
    run_by_node(HERE / "character.test.mjs", character)


def test_bodies_follow_positions_as_they_follow_rotations(bodies: Path) -> None:
    run_by_node(HERE / "orientations.test.mjs", bodies)


@pytest.mark.parametrize("module", ["film", "lens", "motion", "pictures", "player"])
def test_modules_of_viewer(module: str, fixtures: Path) -> None:
    run_by_node(HERE / f"{module}.test.mjs", fixtures)
