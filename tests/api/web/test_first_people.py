"""First people of a running job: the ranges of frames that all cameras have, a few at a time."""

from pipeline.run.engine.stage import DETECT, LOOK
from tests.api.conftest import Live
from tests.api.web.sessions.test_blurred import send, start
from worker.store.files.file_keys import first_people_key

SHA256 = "0" * 64
PEOPLE = b'{"instants":[{"time_s":0.5,"people":[]}]}'


def finish(live: Live, stage: str, people: bytes | None = None) -> None:
    """Finish the next chunk, which is of a stage, and leave its people to be looked at."""
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    assert claim.stage == stage
    if people is not None:
        key = first_people_key(claim.job_id, claim.job_attempt, claim.output_key)
        live.services.artifacts.put_bytes(key, people)
    live.services.store.leases.finish(claim.chunk_id, claim.lease_token, SHA256, 0)


def test_range_is_listed_once_all_cameras_have_it(live: Live) -> None:
    job = start(live, send(live, "cam_0.mp4", "cam_1.mp4"))
    address = f"/v1/jobs/{job['id']}/motion/first-people"
    for _ in range(2):
        finish(live, LOOK)
    finish(live, DETECT)
    assert live.client.get(address).json() == {"ranges": [], "next": 0}
    finish(live, DETECT, PEOPLE)
    listed = live.client.get(address).json()
    assert (len(listed["ranges"]), listed["next"]) == (1, 1)
    assert listed["ranges"][0]["instants"] == [{"time_s": 0.5, "people": []}]
    assert live.client.get(address, params={"from": 1}).json() == {"ranges": [], "next": 1}
    assert live.client.get(address, params={"from": 10**9}).json() == {"ranges": [], "next": 10**9}
    assert live.client.get(address, params={"from": -1}).status_code == 422
    assert live.client.get("/v1/jobs/01976f6e-0000-7000-8000-000000000000/motion/first-people").status_code == 404
