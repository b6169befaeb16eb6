"""Motion for viewers: its description, ranges of frames and of bytes, people, jobs without motion."""

import json
import struct
from typing import Any

import pytest

from api.web.contract.openapi import COMMITTED
from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, problem_of

EXAMPLE = json.loads(COMMITTED.read_text("utf-8"))["components"]["examples"]["MotionDescription"]["value"]
RECORD_BYTES = 48
PEOPLE = ((1, 0, 30), (4, 20, 10), (5, 25, 35))


def record(person: int, frame: int) -> bytes:
    return struct.pack("<12I", person, frame, *range(10))


def records(person: int, first: int, stop: int) -> bytes:
    return b"".join(record(person, frame) for frame in range(first, stop))


def part(person: int, first: int, stop: int) -> bytes:
    return struct.pack("<4I", person, first, stop - first, RECORD_BYTES) + records(person, first, stop)


def description() -> dict[str, Any]:
    people, offset_bytes = [], 0
    for person, start, num_frames in PEOPLE:
        about = {"id": person, "start_frame": start, "num_frames": num_frames, "offset_bytes": offset_bytes}
        people.append(EXAMPLE["people"][0] | about)
        offset_bytes += num_frames * RECORD_BYTES
    document = EXAMPLE | {"num_frames": 60, "people": people}
    del document["revision"]  # which the file lacks
    return document


FILES = {
    "motion.bin": b"".join(records(person, start, start + num_frames) for person, start, num_frames in PEOPLE),
    "motion.json": json.dumps(description()).encode(),
}
WHOLE = part(1, 0, 30) + part(4, 20, 30) + part(5, 25, 60)


@pytest.fixture
def path(live: Live) -> str:
    job_id = live.job_id()
    live.finish(job_id, motion=FILES)
    return f"/v1/jobs/{job_id}/motion"


def test_description_is_stored_one(live: Live, path: str) -> None:
    answer = live.client.get(f"{path}/description")
    assert answer.status_code == 200
    assert answer.json() == description() | {"revision": 0}
    again = live.client.get(f"{path}/description", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


EXPECTED = {
    "": WHOLE,
    "?from=0&to=60": WHOLE,
    "?to=99999999": WHOLE,
    "?from=22&to=27": part(1, 22, 27) + part(4, 22, 27) + part(5, 25, 27),
    "?from=40": part(5, 40, 60),
    "?person=4": part(4, 20, 30),
    "?person=5&person=1&from=29&to=31": part(1, 29, 30) + part(5, 29, 31),
    "?from=10&to=10": b"",
    "?from=30&to=10": b"",
    "?from=60&to=70": b"",
    "?person=2": b"",
}


def test_frames_of_range(live: Live, path: str) -> None:
    for query, expected in EXPECTED.items():
        answer = live.client.get(f"{path}{query}")
        assert (answer.status_code, answer.content) == (200, expected), query
        assert answer.headers["content-type"] == "application/vnd.multicap.motion"
        assert answer.headers["content-length"] == str(len(expected))


RANGES = [
    ("bytes=0-15", 0, 16),
    # From the head of the first person into the frames of the third.
    (f"bytes=3-{len(WHOLE) - 50}", 3, len(WHOLE) - 49),
    ("bytes=1300-1400", 1300, 1401),
    # The last bytes before the head of the second person, which a length of 16 bytes could reach from the wrong side.
    (f"bytes=1440-{len(part(1, 0, 30)) - 5}", 1440, len(part(1, 0, 30)) - 4),
    ("bytes=-10", len(WHOLE) - 10, len(WHOLE)),
]


def test_bytes_of_frames(live: Live, path: str) -> None:
    for wanted, start, stop in RANGES:
        answer = live.client.get(path, headers={"Range": wanted})
        assert (answer.status_code, answer.content) == (206, WHOLE[start:stop]), wanted
        assert answer.headers["content-range"] == f"bytes {start}-{stop - 1}/{len(WHOLE)}"


def test_bytes_behind_end(live: Live, path: str) -> None:
    answer = live.client.get(path, headers={"Range": f"bytes={len(WHOLE)}-"})
    problem_of(answer, 416, "range_not_satisfiable")
    assert answer.headers["content-range"] == f"bytes */{len(WHOLE)}"


def test_each_range_has_its_own_tag(live: Live, path: str) -> None:
    queries = ("", "?from=1", "?to=59", "?person=1", "?person=1&person=4")
    tags = [live.client.get(f"{path}{query}").headers["etag"] for query in queries]
    assert len(set(tags)) == len(queries)
    for query, tag in zip(queries, tags, strict=True):
        assert live.client.get(f"{path}{query}", headers={"If-None-Match": tag}).status_code == 304
    assert live.client.get(f"{path}?from=2", headers={"If-None-Match": tags[1]}).status_code == 200


def test_head_has_length(live: Live, path: str) -> None:
    answer = live.client.head(f"{path}?person=4")
    assert (answer.status_code, answer.headers["content-length"]) == (200, str(len(part(4, 20, 30))))


def test_wrong_queries(live: Live, path: str) -> None:
    for query in ("?from=-1", "?to=x", "?person=a"):
        problem_of(live.client.get(f"{path}{query}"), 422, "invalid_request")


@pytest.mark.parametrize("address", ["", "/description"])
def test_jobs_without_motion(live: Live, address: str) -> None:
    job_id = live.job_id()
    problem_of(live.client.get(f"/v1/jobs/{job_id}/motion{address}"), 409, "not_finished")
    live.finish(job_id)
    problem = problem_of(live.client.get(f"/v1/jobs/{job_id}/motion{address}"), 404, "not_found")
    assert problem["detail"] == "The job has no motion to look at."


def test_downloads_leave_motion_out(live: Live, path: str) -> None:
    results = path.removesuffix("motion") + "results"
    assert [one["name"] for one in live.client.get(results).json()["results"]] == ["person-1.bvh"]
    assert live.client.get(f"{results}/motion.json").status_code == 200


def test_motion_of_revision_stays_until_next_one_is_made(live: Live) -> None:
    job_id = live.job_id()
    found = (PersonSpan(1, 0, 30),)
    live.finish(job_id, motion=FILES, people=found)
    path = f"/v1/jobs/{job_id}/motion"

    def described() -> tuple[int, str]:
        answer = live.client.get(f"{path}/description")
        assert answer.status_code == 200, answer.text
        return answer.json()["revision"], answer.headers["etag"]

    first = described()
    assert first[0] == 0
    assert live.remake(job_id).status_code == 202
    assert described() == first
    assert live.client.get(path, params={"revision": 0}).content == WHOLE
    live.finish(job_id, motion=FILES, people=found)
    revision, etag = described()
    assert revision == 1
    assert etag != first[1]
    problem_of(live.client.get(path, params={"revision": 0}), 409, "conflict")
    assert live.client.get(path, params={"revision": 1}).content == WHOLE
