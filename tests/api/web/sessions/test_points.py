"""Sessions of 3D points: sent to the service with its real check."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, problem_of, running
from tests.e2e.points import write_walk
from tests.warm_programs import WarmPrograms


@pytest.fixture(scope="module")
def checking(make_settings: Callable[..., Settings], warm_programs: WarmPrograms) -> Iterator[Live]:
    """Running service with the real check of files."""
    limits = {"max_keypoints_bytes": 20_000_000, "max_session_bytes": 60_000_000, "preflight_timeout_s": 120.0}
    command = warm_programs.command("pipeline.capture.preflight")
    with running(make_settings(preflight_command=command, **limits)) as live:
        yield live


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Any]]:
    """Parts of a form with two people."""
    paths = write_walk(tmp_path_factory.mktemp("walk"), 1.0)
    return [("points", (path.name, path.read_bytes())) for path in paths]


def post(checking: Live, parts: list[tuple[str, Any]], **manifest: Any) -> Any:
    return checking.client.post("/v1/sessions", files=[*parts, ("manifest", (None, json.dumps(manifest)))])


def test_session_has_clock_of_files_and_no_cameras(checking: Live, walk: list[tuple[str, Any]]) -> None:
    session = post(checking, walk).raise_for_status().json()
    preflight = session["preflight"]
    assert (preflight["cameras"], preflight["timebase"]["num_frames"]) == ([], 25)
    assert {(file["kind"], file["name"]) for file in session["files"]} == {
        ("points", "walker-1.csv"),
        ("points", "walker-2.csv"),
    }
    assert [finding["evidence"] for finding in preflight["findings"]] == 2 * [{"unit": "cm", "up": "z"}]
    turned = post(checking, walk, up="-z", units="mm").raise_for_status().json()["preflight"]
    assert [finding["evidence"] for finding in turned["findings"]] == 2 * [{"unit": "mm", "up": "-z"}]


@pytest.mark.parametrize(
    ("manifest", "pointer"),
    [
        ({"cameras": [{"name": "left"}]}, "/manifest/cameras"),
        ({"layout": "coco-17"}, "/manifest/layout"),
        ({"names": {"knee": "left_kneecap"}}, "/manifest/names"),
        ({"pair_by_order": True}, "/manifest/pair_by_order"),
    ],
)
def test_facts_that_do_not_apply_are_refused(
    checking: Live, walk: list[tuple[str, Any]], manifest: dict[str, Any], pointer: str
) -> None:
    (item,) = problem_of(post(checking, walk, **manifest), 422, "invalid_request")["errors"]
    assert item["pointer"] == pointer


def test_other_files_beside_points_are_refused(checking: Live, walk: list[tuple[str, Any]]) -> None:
    others = [("calibration", ("rig.json", b"{}")), ("videos", ("left.mp4", b"no video"))]
    items = problem_of(post(checking, [*walk, *others]), 422, "invalid_request")["errors"]
    assert {(item["code"], item["pointer"]) for item in items} == {
        ("part_not_allowed", "/calibration"),
        ("part_not_allowed", "/videos"),
    }


def test_damaged_files_are_all_named(checking: Live) -> None:
    sent = [("points", (name, b"no points")) for name in ("a.trc", "b.bvh", "c.xyz")]
    items = problem_of(post(checking, sent), 422, "invalid_request")["errors"]
    assert {(item["file"], item["pointer"]) for item in items if item["file"]} == {
        ("a.trc", "/points/0"),
        ("b.bvh", "/points/1"),
        ("c.xyz", "/points/2"),
    }


def test_names_of_ones_own_and_zip_of_frames(checking: Live) -> None:
    points = {"sl": (0.2, 0.0, 1.4), "sr": (-0.2, 0.0, 1.4), "hl": (0.1, 0.0, 0.9), "hr": (-0.1, 0.0, 0.9)}
    head = ",".join(f"{name}_{axis}_m" for name in points for axis in "xyz")
    row = ",".join(str(value) for place in points.values() for value in place)
    table = [("points", ("own.csv", "\n".join([head, row, row, row, row, row]).encode()))]
    refused = problem_of(post(checking, table, frame_rate_hz=25.0), 422, "invalid_request")["errors"]
    assert [(item["code"], item["pointer"]) for item in refused] == [("keypoints_layout", "/points/0")]
    names = {"sl": "left_shoulder", "sr": "right_shoulder", "hl": "left_hip", "hr": "right_hip"}
    assert post(checking, table, frame_rate_hz=25.0, names=names).status_code == 201
    (item,) = problem_of(post(checking, table, names=names), 422, "invalid_request")["errors"]
    assert (item["code"], item["pointer"]) == ("no_frame_rate", "/manifest/frame_rate_hz")
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as entries:
        for frame in range(5):
            flat = [float(k % 4 and 10 * (k // 4 % 5)) for k in range(25 * 4)]
            place = {2: (-0.2, 0, 1.4), 5: (0.2, 0, 1.4), 9: (-0.1, 0, 0.9), 12: (0.1, 0, 0.9)}
            for joint, xyz in place.items():
                flat[4 * joint : 4 * joint + 4] = [*xyz, 1.0]
            entries.writestr(
                f"walk.v2_{frame:012d}_keypoints.json", json.dumps({"people": [{"pose_keypoints_3d": flat}]})
            )
    sent = [("points", ("walk.v2.zip", archive.getvalue()))]
    assert post(checking, sent, frame_rate_hz=25.0, units="m").raise_for_status().json()["duration_s"] == 0.2


def test_points_calibrate_no_cameras(checking: Live, walk: list[tuple[str, Any]]) -> None:
    session = post(checking, walk).raise_for_status().json()["id"]
    spec = {"method": "people", "session_id": session, "stature_m": [1.7]}
    answer = checking.client.post("/v1/calibrations", files=[("spec", (None, json.dumps(spec)))])
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert item["code"] == "not_a_capture"


def test_keypoints_have_no_table_of_names(checking: Live, tmp_path: Path) -> None:
    sent = [("keypoints", ("left.zip", b"no zip")), ("calibration", ("rig.json", b"{}"))]
    items = problem_of(post(checking, sent, names={"knee": "left_knee"}), 422, "invalid_request")["errors"]
    assert "/manifest/names" in {item["pointer"] for item in items}
