"""Wrong fields of calibrations from people, and of sessions of stored footage: refused, never 5xx, never a hang."""

import json
import random
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

from api.web.settings import Settings
from tests.api.conftest import NO_BROKER, Live, running
from tests.hostile.keypoints import keypoint_files, simulate
from tests.hostile.mutations import OF_TEXT, spoil
from tests.hostile.test_hostile_files import SEED
from tests.hostile.test_hostile_uploads import MAX_S, parts_of

UNKNOWN = "0190b7a4-0000-7000-8000-000000000000"
ODD: tuple[Any, ...] = (
    None, True, -1, 0, 0.2, 178, 1e300, "1.78", "", "tall", [], [[]], [1.7] * 100, [0.2], [178.0], [None], [True],
    ["1.7"], {}, {"a": 1}, UNKNOWN, UNKNOWN.upper(), [UNKNOWN], "session", "\u202e", "a" * 5000, "\ud800", "../../etc",
)  # fmt: skip


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    folder = tmp_path_factory.mktemp("service")
    with running(Settings(data_dir=folder / "data", broker_url=NO_BROKER)) as found:
        yield found


@pytest.fixture(scope="module")
def session_id(live: Live) -> str:
    """Id of a session of keypoints."""
    answer = live.client.post("/v1/sessions", files=parts_of(keypoint_files(simulate())))
    assert answer.status_code == 201, answer.text
    found: str = answer.json()["id"]
    return found


def odd_bodies(good: dict[str, Any], rng: random.Random, number: int) -> Iterator[bytes]:
    """Bodies in which one or two fields have odd values, a field is added, or the text is damaged."""
    fields = [*good, "constructor", "__proto__", "board", "videos", "intrinsics", "purpose", "tenant"]
    for _ in range(number):
        if rng.random() < 0.3:
            yield spoil(json.dumps(good).encode(), rng, OF_TEXT)
            continue
        body = dict(good)
        for field in rng.sample(fields, rng.choice((1, 1, 2))):
            body[field] = rng.choice(ODD)
        yield json.dumps(body).encode()


def send(live: Live, address: str, body: bytes, as_form: bool) -> int:
    """Send a body as JSON, or as the part ``spec`` of a form; check time and kind of the answer."""
    started_s = time.monotonic()
    if as_form:
        answer = live.client.post(address, files=[("spec", (None, body))])
    else:
        answer = live.client.post(address, content=body, headers={"Content-Type": "application/json"})
    assert time.monotonic() - started_s < MAX_S
    assert answer.status_code < 500, (body, answer.text)
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"]
    return answer.status_code


def campaign(live: Live, session_id: str, number: int) -> Counter[int]:
    rng = random.Random(SEED)  # noqa: S311 - the same each time
    people = {"method": "people", "session_id": session_id, "stature_m": [1.78, 1.65], "name": "Room", "units": "m"}
    footage = {"session_id": session_id, "calibration_id": UNKNOWN, "manifest": {"name": "Take"}}
    codes: Counter[int] = Counter()
    for body in odd_bodies(people, rng, number):
        codes[send(live, "/v1/calibrations", body, as_form=rng.random() < 0.5)] += 1
    for body in odd_bodies(footage, rng, number):
        codes[send(live, "/v1/sessions", body, as_form=False)] += 1
    return codes


def test_odd_fields(live: Live, session_id: str) -> None:
    codes = campaign(live, session_id, 30)
    assert codes[422] > 20
    assert live.client.get(f"/v1/sessions/{session_id}").status_code == 200


@pytest.mark.hostile
def test_600_odd_fields(live: Live, session_id: str) -> None:
    codes = campaign(live, session_id, 300)
    assert codes.total() == 600
    assert codes[422] > 200
