"""Takes of phones as their host makes them by clicks, and errors of their people against the truth of the clip."""

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from playwright.sync_api import Locator, Page, expect

from pipeline.validation.evaluation.datasets.rendered import load_rendered
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, GATE_M, accuracy
from tests.e2e.datasets import folder_of
from tests.e2e.phones import Phone, read_places
from tests.e2e.serving import Served

PERIOD = 198  # frames after which a camera's file begins again
PATIENT_MS = 300_000


def open_recording(host: Page, name: str) -> str:
    """Make a recording, and return the link for phones."""
    host.get_by_label("Name of the recording").fill(name)
    host.get_by_role("button", name="New recording").click()
    expect(host.get_by_role("heading", name=name, level=1)).to_be_visible()
    link = host.locator(".record-link").get_attribute("href")
    assert link is not None
    return link


def join(host: Page, joined: list[Phone]) -> None:
    """Join one phone after the other: the service numbers them in this order."""
    for phone in joined:
        phone.allow_camera()
        phone.expect_state("Ready")
        expect(phone_card(host, phone.name).locator(".state")).to_have_text("ready")


def phone_card(host: Page, name: str) -> Locator:
    return (
        host.get_by_role("list", name="Phones")
        .get_by_role("listitem")
        .filter(has=host.get_by_role("heading", name=name, exact=True))
    )


def start(host: Page, name: str, seconds: int) -> None:
    """Start a take by the host's button, and wait until it is some seconds long."""
    host.get_by_label("Name of the next take").fill(name)
    host.get_by_label(re.compile("^Video")).select_option("own")
    host.get_by_role("button", name="Record", exact=True).click()
    reached = "|".join(f"{second:02d}" for second in range(seconds, 60))
    expect(host.locator(".record-time")).to_have_text(re.compile(f"{name} · 0:({reached})"), timeout=60_000)


def take_card(host: Page, name: str) -> Locator:
    return (
        host.get_by_role("list", name="Takes")
        .locator(".record-take")
        .filter(has=host.get_by_role("heading", name=name))
    )


def record(host: Page, name: str, seconds: int, num_phones: int) -> Locator:
    """Record a take, and wait for its clips; return its part of the page."""
    start(host, name, seconds)
    host.get_by_role("button", name="Stop").click()
    take = take_card(host, name)
    expect(take).to_contain_text(f"{num_phones} of {num_phones} clips here", timeout=PATIENT_MS)
    return take


def reconstruct(take: Locator, name: str, words: str = "Done") -> None:
    """Make a capture of a take with its job, and wait for the words of its end."""
    take.get_by_role("button", name=f"Reconstruct {name}").click()
    take.get_by_role("form", name=f"Reconstruct {name}").get_by_role("button", name="Reconstruct", exact=True).click()
    expect(take.locator(".record-job .state").last).to_contain_text(words, timeout=2 * PATIENT_MS)


def recording_of(served: Served, host: Page) -> dict[str, Any]:
    """Recording that the host's page shows."""
    return dict(served.client.get(f"/v1/recordings/{host.url.rsplit('/', 1)[-1]}").raise_for_status().json())


def uploaded_clips(served: Served, take: Mapping[str, Any]) -> list[Path]:
    """Files of a take's clips that no session took yet, of each phone the first part."""
    return [served.data_dir / "uploads" / clip["files"][0]["upload_id"] for clip in take["clips"]]


def videos_of(served: Served, session_id: str, folder: Path) -> dict[str, Path]:
    """Videos of a session by the names of their cameras."""
    session = served.client.get(f"/v1/sessions/{session_id}").raise_for_status().json()
    found = {}
    for camera in session["preflight"]["cameras"]:
        found[camera["name"]] = folder / camera["file"]
        found[camera["name"]].write_bytes(served.client.get(camera["video_url"]).raise_for_status().content)
    return found


def places_late(video: Path, places_hz: float) -> Float[np.ndarray, " frames"]:
    """Places in the camera's file by which the frames of a recording are behind an even course from its first one."""
    frames = read_places(video)
    times_s, places = (np.array(column) for column in zip(*frames, strict=True))
    return (places - places[0] - places_hz * (times_s - times_s[0]) + PERIOD / 2) % PERIOD - PERIOD / 2


def phases_of(offsets_s: Mapping[str, float], videos: Mapping[str, Path], places_hz: float) -> dict[str, float]:
    """Place in the clip at the session's time 0 of each camera, by its frames and its offset."""
    phases: dict[str, float] = {}
    for name, video in videos.items():
        frames = read_places(video)
        first_s = frames[0][0]
        turns = np.array([place - places_hz * (time_s - first_s + offsets_s[name]) for time_s, place in frames])
        phases[name] = mean_place(turns)
    return phases


def mean_place(places: Float[np.ndarray, " frames"]) -> float:
    """Mean of places in a file that begins again."""
    return float(np.angle(np.exp(2j * np.pi * places / PERIOD).sum()) * PERIOD / (2 * np.pi))


def apart(phases: Mapping[str, float]) -> dict[str, float]:
    """Places by which cameras are ahead of the first one."""
    first = next(iter(phases.values()))
    return {name: (phase - first + PERIOD / 2) % PERIOD - PERIOD / 2 for name, phase in phases.items()}


def joints_of(
    served: Served, job_id: str
) -> tuple[Float[np.ndarray, "tracks frames joints 3"], Float[np.ndarray, " frames"]]:
    """Body joints of a job's people in metres, NaN where there are none, with the times of the frames."""
    answer = served.client.get(f"/v1/jobs/{job_id}/results/skeletons.json").raise_for_status().json()
    joints = [answer["joint_names"].index(name) for name in BODY_JOINTS]
    found_m = np.full((len(answer["tracks"]), answer["num_frames"], len(joints), 3), np.nan)
    for row, track in enumerate(answer["tracks"]):
        for frame, positions in enumerate(track["positions_m"], track["start_frame"]):
            found_m[row, frame] = [positions[joint] or [np.nan] * 3 for joint in joints]
    return found_m, answer["start_time_s"] + np.arange(answer["num_frames"]) / answer["frame_rate_hz"]


def truth_at(places: Float[np.ndarray, " frames"]) -> Float[np.ndarray, "people frames joints 3"]:
    """True body joints at places of the file, forth and back, between two frames of the clip too."""
    truth = load_rendered(folder_of("rendered"))
    true_m = truth.xyz_m[:, :, [truth.names.index(name) for name in BODY_JOINTS]]
    turned = places % PERIOD
    forth = np.where(turned > PERIOD / 2, PERIOD - turned, turned)
    below = np.minimum(forth.astype(int), true_m.shape[1] - 2)
    share = (forth - below)[:, None, None]
    return (1 - share) * true_m[:, below] + share * true_m[:, below + 1]


def mean_error_mm(
    found_m: Float[np.ndarray, "tracks frames joints 3"], true_m: Float[np.ndarray, "people frames joints 3"]
) -> float:
    """Mean distance of joints from the truth (MPJPE)."""
    error = accuracy(found_m, true_m, GATE_M).mpjpe_mm
    assert error is not None
    return error


def moved_into(
    found_m: Float[np.ndarray, "tracks frames joints 3"], true_m: Float[np.ndarray, "people frames joints 3"]
) -> tuple[Float[np.ndarray, "tracks frames joints 3"], float]:
    """People moved into the world of the truth by the similarity that fits best, and its scale (Umeyama 1991).

    The people with most frames are tried as each order of the true ones.
    """
    known = np.isfinite(found_m).all((2, 3))
    longest = np.argsort(-known.sum(1))[: len(true_m)]
    best = None
    for people in itertools.permutations(range(len(true_m)), len(longest)):
        pairs = [
            (found_m[row, known[row]], true_m[person, known[row]]) for row, person in zip(longest, people, strict=True)
        ]
        from_m, to_m = (np.concatenate([pair[side].reshape(-1, 3) for pair in pairs]) for side in (0, 1))
        from_mean, to_mean = from_m.mean(0), to_m.mean(0)
        left, sizes, right = np.linalg.svd((to_m - to_mean).T @ (from_m - from_mean))
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        rotation = left * signs @ right
        scale = float(sizes @ signs / ((from_m - from_mean) ** 2).sum())
        moved = scale * (found_m - from_mean) @ rotation.T + to_mean
        rest = float(np.linalg.norm(scale * (from_m - from_mean) @ rotation.T + to_mean - to_m, axis=1).mean())
        if best is None or rest < best[0]:
            best = (rest, moved, scale)
    assert best is not None
    return best[1], best[2]
