"""The extension in Blender, installed from its zip, with a service that runs."""

import contextlib
import hashlib
import json
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import Any

import numpy as np
import pytest

from api.blender.build import build
from api.web.settings import Settings
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.file_formats import Export
from pipeline.export.character.bone_names import LIMBS
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.results import write_results
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.outputs.pattern import LAYOUT, pattern_instants
from pipeline.run.live.outputs.pattern import RATE_HZ as PATTERN_HZ
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton
from tests.api.blender.conftest import WrongService, says
from tests.api.blender.test_client import ServiceGate
from tests.api.conftest import Live, running
from tests.e2e.foreign import BLENDER
from tests.pipeline.export.character.characters import bones_of, character, odd_bones
from tests.pipeline.export.test_scene import FBX, GLB, NAMES, named
from tests.pipeline.export.test_timelines import NUM_FRAMES, RATE_HZ, nearest_m, two_people
from tests.ports import free_port
from worker.store.model.rights import Scope

__all__ = ["named", "two_people"]
pytestmark = pytest.mark.blender
Steps = Sequence[tuple[str, dict[str, Any]]]


@pytest.fixture(scope="session")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("extension"))


@pytest.fixture
def blender(extension: Path, tmp_path: Path) -> Callable[..., list[Any]]:
    """Run steps in Blender; return what they found."""

    def run(
        address: str, steps: Steps, key: str = "", on_line: Callable[[str], None] = lambda _line: None
    ) -> list[Any]:
        if not BLENDER.is_file():
            pytest.skip("Blender is not installed (`make verify-exports` does it)")
        job, out = tmp_path / "job.json", tmp_path / "out.json"
        job.write_text(
            json.dumps({"zip": str(extension), "address": address, "key": key, "steps": steps, "out": str(out)})
        )
        command = [BLENDER, Path(__file__).with_name("program.py"), job]
        environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "blender"), "PYTHONUNBUFFERED": "1"}
        output = ""
        with subprocess.Popen(command, stdout=PIPE, stderr=STDOUT, text=True, env=environment) as process:
            assert process.stdout is not None
            for line in process.stdout:
                output += line
                on_line(line)
        assert process.returncode == 0, output
        assert "Traceback" not in output, output
        found: list[Any] = json.loads(out.read_text())
        return found

    return run


@pytest.fixture(scope="module")
def files(named: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """GLB files of a take."""
    paths = write_results(named, tmp_path_factory.mktemp("files"), GLB)
    return {path.name: path.read_bytes() for path in paths if path.suffix == ".glb"}


def files_at(rate_hz: float, named: Reconstruction, exports: tuple[Export, ...], folder: Path) -> dict[str, bytes]:
    """Files of the take at another frame rate."""
    motions = tuple(replace(motion, frame_rate_hz=rate_hz) for motion in named.motions)
    timebase = replace(named.timebase, frame_rate_hz=rate_hz)
    take = replace(named, timebase=timebase, animation=replace(named.animation, motions=motions))
    paths = write_results(take, folder, exports)
    return {path.name: path.read_bytes() for path in paths if path.suffix.removeprefix(".") in exports}


def with_people(live: Live, named: Reconstruction, files: dict[str, bytes]) -> str:
    """Job of a take with files; its people have the names of the take."""
    job_id = live.job_id()
    live.finish(job_id, scenes=files, names={f"person-{motion.track_id}": motion.name for motion in named.motions})
    return job_id


def test_import(
    make_settings: Callable[..., Settings],
    named: Reconstruction,
    files: dict[str, bytes],
    blender: Callable[..., list[Any]],
) -> None:
    with running(make_settings()) as live:
        _, key = live.services.store.keys.add("studio", "blender", frozenset({Scope.READ, Scope.WRITE}))
        live.client.headers["Authorization"] = f"Bearer {key}"
        with_people(live, named, files)
        panel, imported, scene, left = blender(
            str(live.client.base_url),
            [
                ("show_people", {}),
                ("press", {"name": "import_people"}),
                ("scene", {}),
                ("unregister", {}),
            ],
            key,
        )
    assert panel["tenant"] == "studio"
    assert panel["people"] == list(NAMES)
    assert imported["message"] == "Imported 2 people."
    assert (scene["rate_hz"], scene["frames"]) == (pytest.approx(RATE_HZ), [0, NUM_FRAMES - 1])
    assert {name for name, kind in scene["objects"].items() if kind == "ARMATURE"} == set(NAMES)
    for name in NAMES:
        for joint in SKELETON:
            found_m = np.array(scene["heads"][name][joint.name])
            np.testing.assert_allclose(found_m, nearest_m(named)[name][:, INDEX[joint.name]], atol=1e-4)
    assert left == []


@pytest.mark.parametrize("rate_hz", [30000 / 1001, 24000 / 1001, 60000 / 1001, 12.5])
def test_keys_lie_at_frames_at_any_rate(
    live: Live, named: Reconstruction, blender: Callable[..., list[Any]], tmp_path: Path, rate_hz: float
) -> None:
    """Blender's importer of GLB places keys by ``fps * fps_base``, the extension by the frame rate."""
    with_people(live, named, files_at(rate_hz, named, GLB, tmp_path / "take"))
    path = tmp_path / "character.glb"
    path.write_bytes(character(bones_of("default")))
    _, _, on_timeline, *_, put, both = blender(
        str(live.client.base_url),
        [
            ("show_people", {}),
            ("press", {"name": "import_people"}),
            ("keys", {}),
            ("choose", {"people": [1]}),
            ("open_armature", {"path": str(path)}),
            ("press", {"name": "put_on"}),
            ("keys", {}),
        ],
    )
    assert not put["is_error"], put["message"]
    fps, fps_base = on_timeline.pop("rate")
    assert fps / fps_base == pytest.approx(rate_hz)
    assert set(on_timeline) == set(NAMES)
    for span in on_timeline.values():
        assert span == pytest.approx([0.0, NUM_FRAMES - 1], abs=1e-3)
    (of_armature,) = (span for name, span in both.items() if name not in {*NAMES, "rate"})
    assert of_armature == pytest.approx([0.0, NUM_FRAMES - 1], abs=1e-3)


def test_keys_of_people_keep_their_times_at_rate_of_scene(
    live: Live, named: Reconstruction, files: dict[str, bytes], blender: Callable[..., list[Any]]
) -> None:
    with_people(live, named, files)
    *_, keys = blender(
        str(live.client.base_url),
        [
            ("set_panel", {"has_timeline": False}),
            ("set_rate", {"fps": 30, "fps_base": 1.001}),
            ("show_people", {}),
            ("press", {"name": "import_people"}),
            ("keys", {}),
        ],
    )
    assert keys.pop("rate") == pytest.approx([30, 1.001])
    last = (NUM_FRAMES - 1) / RATE_HZ * 30 / 1.001
    assert {name: span[1] for name, span in keys.items()} == pytest.approx(dict.fromkeys(NAMES, last), abs=1e-3)


def test_fbx_without_glb(live: Live, named: Reconstruction, blender: Callable[..., list[Any]], tmp_path: Path) -> None:
    """The importer of Blender gives the scene the file's frame rate; the frames stay without a description."""
    rate_hz = 30000 / 1001
    with_people(live, named, files_at(rate_hz, named, FBX, tmp_path / "take"))
    _, imported, keys, _, put, scene = blender(
        str(live.client.base_url),
        [
            ("show_people", {}),
            ("press", {"name": "import_people"}),
            ("keys", {}),
            ("choose_armature", {"name": "person-1"}),
            ("press", {"name": "put_on"}),
            ("scene", {}),
        ],
    )
    assert imported["message"] == "Imported 2 people."
    for name in NAMES:
        assert keys[name] == pytest.approx([1.0, NUM_FRAMES], abs=1e-3)
    assert {name for name, kind in scene["objects"].items() if kind == "ARMATURE"} == set(NAMES)
    assert (scene["rate_hz"], scene["frames"]) == (pytest.approx(rate_hz), [1, 250])
    assert put["message"] == "Choose one person whose motion the armature gets."


def test_cameras_of_take(
    live: Live, named: Reconstruction, files: dict[str, bytes], blender: Callable[..., list[Any]]
) -> None:
    with_people(live, named, files)
    _, _, _, _, imported, scene = blender(
        str(live.client.base_url),
        [
            ("set_panel", {"has_timeline": False}),
            ("show_people", {}),
            ("choose", {"people": []}),
            ("set_panel", {"has_cameras": True}),
            ("press", {"name": "import_people"}),
            ("scene", {}),
        ],
    )
    assert imported["message"] == f"Imported {len(named.cameras)} cameras."
    kinds = set(scene["objects"].values())
    assert kinds == {"CAMERA", "MESH"}
    assert {camera.name for camera in named.cameras} < set(scene["objects"])
    assert (scene["rate_hz"], scene["frames"], scene["actions"]) == (24.0, [1, 250], [])


@pytest.mark.parametrize(("rig", "scale"), [("mixamo", 0.01), ("default", 1.0), ("game_engine", 1.0)])
def test_motion_on_armature(
    live: Live,
    named: Reconstruction,
    files: dict[str, bytes],
    blender: Callable[..., list[Any]],
    tmp_path: Path,
    rig: str,
    scale: float,
) -> None:
    """The armature stands elsewhere, faces another way, and is smaller."""
    path = tmp_path / "character.glb"
    path.write_bytes(character(bones_of(rig), armature_scale=scale))
    with_people(live, named, files)
    *_, bones, put, drawn, scene = blender(
        str(live.client.base_url),
        [
            ("show_people", {}),
            ("choose", {"people": [1]}),
            ("open_armature", {"path": str(path)}),
            ("move_armature", {"place": [3.0, 1.0, 0.0], "degrees": 70.0, "size": 0.7}),
            ("bones", {}),
            ("press", {"name": "put_on"}),
            ("draw", {}),
            ("scene", {}),
        ],
    )
    assert not put["is_error"], put["message"]
    assert put["message"].endswith("moves as Zoë K..")
    assert "Put motion on armature" in drawn["MULTICAP_PT_character"]
    assert (scene["rate_hz"], scene["frames"]) == (pytest.approx(RATE_HZ), [0, NUM_FRAMES - 1])
    assert "Zoë K." in scene["actions"]
    ((_, heads),) = scene["heads"].items()
    person = nearest_m(named)["Zoë K."]
    for limb in LIMBS:
        for above, below in pairwise(limb):
            own = np.array(heads[bones[below]]) - np.array(heads[bones[above]])
            way = person[:, INDEX[below]] - person[:, INDEX[above]]
            cosines = (own * way).sum(1) / np.linalg.norm(own, axis=1) / np.linalg.norm(way, axis=1)
            assert np.degrees(np.arccos(cosines.min())) < 0.05, below
    hips = np.array(heads[bones["Hips"]])
    assert np.ptp(hips[:, :2], axis=0).max() > 0.5 * np.ptp(person[:, INDEX["Hips"], :2], axis=0).max()


def test_bones_whose_names_tell_nothing(
    live: Live, named: Reconstruction, files: dict[str, bytes], blender: Callable[..., list[Any]], tmp_path: Path
) -> None:
    """The service recognises them by the shape of the armature, which stands elsewhere and is smaller."""
    path = tmp_path / "character.glb"
    path.write_bytes(character(odd_bones()))
    with_people(live, named, files)
    *_, recognised, _, bones, drawn, put = blender(
        str(live.client.base_url),
        [
            ("show_people", {}),
            ("choose", {"people": [0]}),
            ("open_armature", {"path": str(path)}),
            ("move_armature", {"place": [3.0, 1.0, 0.0], "degrees": 70.0, "size": 0.7}),
            ("press", {"name": "recognise"}),
            ("press", {"name": "ask_for_bones"}),
            ("bones", {}),
            ("draw", {}),
            ("press", {"name": "put_on"}),
        ],
    )
    assert recognised["is_error"]
    expected = map_bones(decode_character("a.glb", path.read_bytes())).bones
    assert {joint: bone for joint, bone in bones.items() if bone} == expected
    assert "Ask the service" in drawn["MULTICAP_PT_character"]
    assert not put["is_error"], put["message"]
    assert live.client.get("/v1/characters").json()["characters"] == []


def test_send_folder(live: Live, blender: Callable[..., list[Any]], tmp_path: Path) -> None:
    folder = tmp_path / "Walk 7"
    folder.mkdir()
    for number in range(2):
        (folder / f"cam_{number}.mp4").write_bytes(b"video")
    wrong, _, _, panels = blender(
        str(live.client.base_url),
        [
            ("press", {"name": "send"}),
            ("press", {"name": "connect"}),
            ("set_panel", {"folder": str(folder)}),
            ("draw", {}),
        ],
    )[:4]
    assert wrong["message"] == "Choose the folder with the videos."
    assert "Send and reconstruct" in panels["MULTICAP_PT_send"]
    (folder / "calibration.toml").write_bytes(b"[cam_0]")
    stop_waiting = [
        ("set_panel", {"folder": str(folder), "has_human": True}),
        ("press", {"name": "send", "seconds": 6.0}),
        ("draw", {}),
    ]
    _, sent, shown = blender(str(live.client.base_url), stop_waiting)
    (session,) = live.client.get("/v1/sessions").json()["sessions"]
    assert (session["name"], session["num_jobs"]) == ("Walk 7", 1)
    (job,) = live.client.get("/v1/jobs").json()["jobs"]
    assert (job["spec"]["body"], job["spec"]["exports"]) == ("human", ["glb"])
    assert sent["is_busy"]
    assert any("queued" in text for text in shown["MULTICAP_PT_service"])


def test_sending_is_stopped(
    make_settings: Callable[..., Settings], blender: Callable[..., list[Any]], tmp_path: Path
) -> None:
    folder = tmp_path / "Large"
    folder.mkdir()
    for number in range(2):
        (folder / f"cam_{number}.mp4").write_bytes(b"video" * 8_000_000)
    (folder / "calibration.toml").write_bytes(b"[cam_0]")
    with running(make_settings(max_file_bytes=50_000_000, max_session_bytes=100_000_000)) as live:
        _, stopped = blender(str(live.client.base_url), [("set_panel", {"folder": str(folder)}), ("stop_sending", {})])
        assert live.client.get("/v1/sessions").json()["sessions"] == []
    assert stopped["message"] == "Stopped."
    assert stopped["took_s"] < 1.0


def test_service_dies_while_job_is_followed(live: Live, blender: Callable[..., list[Any]]) -> None:
    """The panel says so and tries on; Blender is never held up."""
    live.job_id()
    gate = ServiceGate(live.address)
    found = blender(
        gate.address,
        [("press", {"name": "connect"}), ("press", {"name": "jobs"}), ("follow", {"seconds": 12.0})],
        on_line=lambda line: gate.close() if "followed" in line else None,
    )
    assert any("queued" in text for text in found[-1]["texts"])
    assert "It is tried again." in found[-1]["texts"][-1]
    assert found[-1]["longest_s"] < 0.5


HOSTILE = {
    "/healthz": {"status": "ok"},
    "/v1/caller": {"tenant": "x" * 1000, "scopes": ["read", "write"]},
    "/v1/options": {"choices": [{"name": "exports"}, {"name": "timeline"}]},
    "/v1/sessions": {"sessions": [{"id": "a", "name": "../../\u202e\u0000x", "num_jobs": 1}], "next_cursor": None},
    "/v1/sessions/a/jobs": {"jobs": [{"id": "j", "session_id": "a", "state": "succeeded", "session_name": "/etc"}]},
    "/v1/jobs/j": {"id": "j", "session_id": "a", "state": "succeeded", "session_name": "../../etc/\nx"},
}


def test_hostile_service_is_survived(
    blender: Callable[..., list[Any]], wrong_service: WrongService, files: dict[str, bytes]
) -> None:
    content = files["person-1.glb"].replace(b'"byteLength"', b'"bytelength"', 1)
    listed = [
        {
            "name": "x.glb",
            "kind": "glb",
            "format": "glb",
            "person": 1,
            "person_name": "../..\x00" + "ü" * 300,
            "num_bytes": len(body),
            "sha256": hashlib.sha256(body).hexdigest(),
        }
        for body in (content, files["person-1.glb"])
    ]
    for path, document in HOSTILE.items():
        wrong_service.answers[path] = says(200, json.dumps(document).encode())
    wrong_service.answers["/v1/jobs/j/results"] = says(200, json.dumps({"results": listed[:1]}).encode())
    wrong_service.answers["/v1/jobs/j/results/x.glb"] = says(200, content)
    panel, imported, scene = blender(
        wrong_service.address, [("show_people", {}), ("press", {"name": "import_people"}), ("scene", {})]
    )
    assert panel["captures"][0].startswith("../../x - ")
    assert len(panel["tenant"]) == 60
    assert "GLB file" in imported["message"]
    assert (scene["objects"], scene["collections"]) == ({}, [])
    wrong_service.answers["/v1/jobs/j/results"] = says(200, json.dumps({"results": listed[1:]}).encode())
    wrong_service.answers["/v1/jobs/j/results/x.glb"] = says(200, files["person-1.glb"])
    _, imported, scene = blender(
        wrong_service.address, [("show_people", {}), ("press", {"name": "import_people"}), ("scene", {})]
    )
    assert not imported["is_error"]
    ((name, _),) = scene["heads"].items()
    assert name == "../.." + "ü" * 27


def test_armature_moves_live(
    live: Live, named: Reconstruction, files: dict[str, bytes], blender: Callable[..., list[Any]], tmp_path: Path
) -> None:
    """A character in an A-pose, elsewhere and smaller, which has an action; strangers send to its port, too."""
    path = tmp_path / "character.glb"
    path.write_bytes(character(bones_of("mixamo"), armature_scale=0.01))
    with_people(live, named, files)
    motion, frame, num_bones, port = named.motions[0], 20, len(SKELETON), free_port()
    person_m = forward_kinematics(motion)[frame]
    turns, lengths_m = motion.parent_from_joint[frame, :num_bones], motion.bone_length_m[:num_bones]
    pose = LiveSkeleton(motion.root_m[frame], turns, lengths_m, person_m[:num_bones])
    instant = LiveInstant(1.0, (LivePerson(1, np.zeros((17, 3)), pose),), 0.0)

    def send() -> None:
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with LiveOutputs([f"vmc://127.0.0.1:{port}"]) as outputs, stranger:
            outputs.begin(["nose"], 100.0)
            for _ in range(300):
                stranger.sendto(b"GET / HTTP/1.1", ("127.0.0.1", port))
                outputs.show(instant)
                time.sleep(0.01)

    sending = threading.Thread(target=send)
    *_, bones, _, received, _, scene = blender(
        str(live.client.base_url),
        [
            ("show_people", {}),
            ("choose", {"people": [1]}),
            ("open_armature", {"path": str(path)}),
            ("move_armature", {"place": [3.0, 1.0, 0.0], "degrees": 70.0, "size": 0.7}),
            ("press", {"name": "put_on"}),
            ("bones", {}),
            ("set_panel", {"live_port": port}),
            ("receive", {"seconds": 30.0}),
            ("draw", {}),
            ("scene", {}),
        ],
        on_line=lambda line: sending.start() if "listening" in line else None,
    )
    sending.join()
    waits, moves = received["said"]
    assert f"waits for a live capture at port {port}" in waits
    assert moves.endswith("moves as the people of the live capture.")
    assert received["drawn"] == ["Take", "Record take", "Receive live"]
    assert (received["actions"], received["after"]) == ([], ["Zoë K."])
    heads = received["heads"]
    for limb in LIMBS:
        for above, below in pairwise(limb):
            own = np.array(heads[bones[below]]) - np.array(heads[bones[above]])
            way = person_m[INDEX[below]] - person_m[INDEX[above]]
            cosine = own @ way / np.linalg.norm(own) / np.linalg.norm(way)
            assert np.degrees(np.arccos(min(1.0, cosine))) < 0.05, below
    assert scene["actions"]


@contextlib.contextmanager
def sending(port: int, num_people: int) -> Iterator[Callable[[str], None]]:
    """Send people of the test pattern from the line ``listening`` on."""
    is_over, begins = threading.Event(), threading.Event()

    def send() -> None:
        begins.wait()
        with LiveOutputs([f"vmc://127.0.0.1:{port}?people={num_people}"]) as outputs:
            outputs.begin(LAYOUT.joints.names, PATTERN_HZ)
            instant_at, start_s, number = pattern_instants(num_people), time.monotonic(), 0
            while not is_over.wait(max(0.0, start_s + number / PATTERN_HZ - time.monotonic())):
                outputs.show(instant_at(number))
                number = max(number + 1, int((time.monotonic() - start_s) * PATTERN_HZ))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield lambda line: begins.set() if "listening" in line else None
    finally:
        is_over.set()
        begins.set()
        thread.join()


def off_path_m(heads: Mapping[str, list[float]], person: int) -> float:
    """Distance of a pose from the nearest instant of a person of the test pattern: hips, knee and a finger."""
    joints, fingers, instant_at = ("Hips", "LeftLeg", "RightHandIndex3"), FingerPoses(LAYOUT.joints.names), PATTERN
    distances_m = []
    for number in range(360):
        skeleton = fingers.with_fingers(instant_at(number)).people[person - 1].skeleton
        assert skeleton is not None
        pose_m = skeleton.joint_m[[INDEX[joint] for joint in joints]]
        distances_m.append(np.abs(np.array([heads[joint] for joint in joints]) - pose_m).max())
    return min(distances_m)


PATTERN = pattern_instants(4)


@pytest.mark.parametrize(
    ("middle", "ends"),
    [("", "record"), ("", "receive"), ("", "record receive"), ("undo", "record"), ("Armature", "record")],
)
def test_take_of_four_people_with_fingers(
    middle: str, ends: str, live: Live, blender: Callable[..., list[Any]], tmp_path: Path
) -> None:
    """Person 2 has a character, the others get simple armatures; a take loses nothing by a stop or what is undone."""
    path, port = tmp_path / "character.glb", free_port()
    path.write_bytes(character(bones_of("mixamo"), armature_scale=0.01))
    with sending(port, 4) as on_line:
        *_, bones, _, taken, undone = blender(
            str(live.client.base_url),
            [
                ("set_rate", {"fps": 25, "fps_base": 1.0}),
                ("open_armature", {"path": str(path)}),
                ("set_panel", {"live_port": port, "take": "Walk"}),
                ("bones", {}),
                ("choose_live", {"person": 2}),
                ("record", {"num_people": 4, "seconds": 4.0, "middle": middle, "ends": ends}),
                ("undo", {}),
            ],
            on_line=on_line,
        )
    names = {f"Person {number}": number for number in (1, 3, 4)} | {
        "Person 2" if middle == "Armature" else "Armature": 2
    }
    assert taken["ended"]["message"].startswith("Walk 1: ")
    assert not taken["ended"]["is_error"]
    assert taken["drawn"] == ["Take", "Record take", "Receive live"]
    assert taken["own"] == {name: [f"Walk 1 {name}"] for name in names}
    (span,) = {tuple(span) for span in taken["actions"].values()}
    assert (span[0], taken["actions"].keys()) == (1.0, {f"Walk 1 {name}" for name in names})
    assert span[1] > 50  # of 100 at least, on a busy machine
    for name, person in names.items():
        for frame in (5, int(span[1]) // 2, int(span[1]) - 5) if name != "Armature" else ():
            assert off_path_m(taken["poses"][str(frame)][name], person) < 0.03
    for name in names:
        hips = bones["Hips"] if name == "Armature" else "Hips"
        places_m = np.array([pose[name][hips] for pose in taken["poses"].values()])
        assert np.ptp(places_m, axis=0).max() > 0.3
    assert set(undone["before"]) == set(undone["redo"]) == taken["actions"].keys()
    assert undone["undo"] == []


def test_taken_port_is_reported(live: Live, blender: Callable[..., list[Any]], tmp_path: Path) -> None:
    path, port = tmp_path / "character.glb", free_port()
    path.write_bytes(character(bones_of("default")))
    *_, drawn, received = blender(
        str(live.client.base_url),
        [
            ("open_armature", {"path": str(path)}),
            ("set_panel", {"live_port": port}),
            ("take_port", {"port": port}),
            ("draw", {}),
            ("receive", {"seconds": 5.0}),
        ],
    )
    assert "Receive live" in drawn["MULTICAP_PT_live"]
    assert received["said"][0] == f"Port {port} can't be used: another program has it. Choose another one."
