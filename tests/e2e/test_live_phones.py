"""Phones of a recording as live cameras: real browsers with film as camera, from the host's link to people in 3D."""

import json
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import UInt8
from playwright.sync_api import Page, expect
from websockets.sync.client import connect

from pipeline.calibration.write import encode
from pipeline.core.runtime.child_processes import python_command
from tests.api.web.live.messages import CAMERA_PROGRAM
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.phone_takes import join, open_recording, phone_card, recording_of
from tests.e2e.phones import BLOCK_PX, NUM_BITS, Phone, phones
from tests.e2e.serving import Served, serving
from tests.e2e.simulated_detection import filmed_room, pictures
from tests.e2e.test_live_cameras_page import STARTED_MS, choose_calibration

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("page")]

RATE_HZ, SIZE_PX = 10, (640, 360)
INSTANT = 35  # of the scene, at which all cameras see all three people
NUM_PLACES = 2**NUM_BITS
CLOCK_S = 0.012  # what the phones' clocks are uncertain by
NUM_COMPARED = 40

# Program in the place of the one that opens cameras: it tells the time of each picture, and the place that it shows.
PLACES = f"""{CAMERA_PROGRAM}import cv2
import numpy as np
names = [source["camera"] for source in start["sources"]]
answer(b"R", {{"type": "ready", "cameras": names, "joints": ["nose"], "bones": ["Hips"], "parents": [None],
               "rig": [], "frame_rate_hz": 12.5, "layout": "coco-17"}})
sockets = {{socket.socket(fileno=source["pictures"]): source["camera"] for source in start["sources"]}}
while True:
    ready, _, _ = select.select([sys.stdin, *sockets], [], [])
    if sys.stdin in ready:
        break
    for one in ready:
        packet = one.recv(2**18)
        taken_s = struct.unpack_from("<d", packet, 4)[0] - time.monotonic() + time.time()
        gray = cv2.imdecode(np.frombuffer(packet[12:], np.uint8), cv2.IMREAD_GRAYSCALE)
        blocks = gray[:{BLOCK_PX}, : {NUM_BITS * BLOCK_PX}].reshape({BLOCK_PX}, {NUM_BITS}, {BLOCK_PX})[4:-4, :, 4:-4]
        place = int(np.dot(blocks.mean((0, 2)) > 128, 1 << np.arange({NUM_BITS})))
        answer(b"S", {{"type": "notice", "message": json.dumps([sockets[one], taken_s, place, *gray.shape])}})
answer(b"E", {{"received": 0, "taken": 0, "late": 0, "dropped": 0}})
"""


def write_film(target: Path, frames: Sequence[UInt8[np.ndarray, "rows columns"]], size_px: tuple[int, int]) -> None:
    """Write frames in YUV 4:2:0 as a file that Chromium takes for a camera."""
    width, height = size_px
    with target.open("wb") as file:
        file.write(f"YUV4MPEG2 W{width} H{height} F{RATE_HZ}:1 Ip A1:1 C420jpeg\n".encode())
        for frame in frames:
            file.write(b"FRAME\n" + frame.tobytes())


def numbered_frames() -> list[UInt8[np.ndarray, "rows columns"]]:
    """Gray frames whose numbers are in blocks at the left and top."""
    frames = []
    for place in range(NUM_PLACES):
        frame = np.full((SIZE_PX[1] * 3 // 2, SIZE_PX[0]), 128, np.uint8)
        for bit in range(NUM_BITS):
            frame[:BLOCK_PX, bit * BLOCK_PX : (bit + 1) * BLOCK_PX] = 235 if place >> bit & 1 else 16
        frames.append(frame)
    return frames


@contextmanager
def joined_phones(
    served: Served, cameras: Sequence[tuple[str, Path]], folder: Path
) -> Iterator[tuple[Page, list[Phone], str]]:
    """Page of the host of a recording, its phones, and its id."""
    with opened(f"{served.client.base_url}#/record") as host:
        link = open_recording(host, "Rehearsal")
        with phones(host, link, cameras, folder) as found:
            join(host, found)
            yield host, found, recording_of(served, host)["id"]


def test_phones_become_people_in_3d(tmp_path: Path) -> None:
    cameras = []
    for number, camera in enumerate(filmed_room().cameras):
        picture = pictures(number)[INSTANT]
        path = tmp_path / f"{camera.name}.y4m"
        still = picture.reformat(format="yuv420p").to_ndarray()
        write_film(path, [still] * RATE_HZ, (picture.width, picture.height))
        cameras.append((camera.name, path))
    command = json.dumps(python_command("-m", "tests.e2e.simulated_detection"))
    with (
        serving(tmp_path / "data", MULTICAP_LIVE_CAMERAS_COMMAND=command) as served,
        joined_phones(served, cameras, tmp_path) as (host, joined, recording_id),
        opened(f"{served.client.base_url}#/live") as page,
    ):
        choose_calibration(page, tmp_path)
        page.get_by_label("Phones of a recording").select_option("Rehearsal")
        first = page.get_by_role("combobox", name="Address of cam_00")
        expect(first).to_have_value(f"phone://{recording_id}/1")
        page.get_by_label("Keep as a capture").check()
        assert axe_findings(page) == []
        page.get_by_role("button", name="Start the capture").click()
        expect(page.locator(".live-stage")).to_have_attribute("data-people", "3", timeout=STARTED_MS)
        for phone in joined:
            phone.expect_state("Live")
            expect(phone.page.get_by_text("Live. The service gets this picture now.")).to_be_visible()
            expect(page.get_by_role("row", name=re.compile(f"{phone.name} open [1-9]"))).to_be_visible()
            expect(phone_card(host, phone.name).locator(".state")).to_have_text("live")
        assert axe_findings(joined[0].page) == []
        joined[1].page.reload()  # a phone that leaves for a moment is a camera again
        joined[1].expect_state("Live")
        expect(page.get_by_role("row", name=re.compile("cam_01 open [1-9]"))).to_be_visible(timeout=STARTED_MS)
        page.get_by_role("button", name="End now").click()
        expect(page.get_by_text(re.compile("frames of .* are kept"))).to_be_visible(timeout=STARTED_MS)
        for phone in joined:
            phone.expect_state("Ready")
        (session,) = served.client.get("/v1/sessions").json()["sessions"]
        sizes_px = [camera["size_px"] for camera in session["preflight"]["cameras"]]
        assert sizes_px == [[256, 144]] * 3  # of the pictures, of which the keypoints are


def test_pictures_have_the_times_of_their_frames(tmp_path: Path) -> None:
    film, program = tmp_path / "film.y4m", tmp_path / "program.py"
    write_film(film, numbered_frames(), SIZE_PX)
    program.write_text(PLACES, encoding="utf-8")
    calibration = json.loads(encode(filmed_room().cameras[:2]))
    for camera, name in zip(calibration["cameras"], ("Left", "Right"), strict=True):
        camera["name"] = name
    command = json.dumps([sys.executable, "-P", str(program)])
    with (
        serving(tmp_path / "data", MULTICAP_LIVE_CAMERAS_COMMAND=command) as served,
        joined_phones(served, [("Left", film), ("Right", film)], tmp_path) as (_, joined, recording_id),
        connect(f"ws://127.0.0.1:{served.client.base_url.port}/v1/live", max_size=None) as client,
    ):
        sources = [f"phone://{recording_id}/{number}" for number in (1, 2)]
        cameras = [{"camera": phone.name, "source": source} for phone, source in zip(joined, sources, strict=True)]
        client.send(json.dumps({"type": "start_cameras", "calibration": calibration, "cameras": cameras}))
        ready = json.loads(client.recv(STARTED_MS / 1000))
        assert ready["type"] == "ready", ready
        for phone in joined:
            phone.expect_state("Live")
            phone.watch()
        came: dict[str, list[tuple[float, int]]] = {"Left": [], "Right": []}
        while min(map(len, came.values())) < NUM_COMPARED:
            message = json.loads(client.recv(60.0))
            if message["type"] == "notice":
                name, taken_s, place, height, width = json.loads(message["message"])
                assert (width, height) == SIZE_PX
                came[name].append((taken_s, place))
        for phone in joined:
            times_s, places = (np.array(column) for column in zip(*phone.taken(), strict=True))
            errors_s = [
                np.abs(times_s[places == place] - taken_s).min()
                for taken_s, place in came[phone.name]
                if place in places and times_s[0] < taken_s < times_s[-1]
            ]
            shown = {"phone": phone.name, "pictures": len(errors_s), "error_ms": 1e3 * np.median(errors_s)}
            print(shown)  # noqa: T201 - how exact the times are
            assert len(errors_s) > NUM_COMPARED / 2
            assert np.median(errors_s) < CLOCK_S
