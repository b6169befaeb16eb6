"""Metrics, read by Prometheus' own parser."""

import sqlite3

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.api.conftest import Live, raw

OF_CHUNKS = ("multicap_oldest_chunk_seconds", "multicap_oldest_chunk_progress", "multicap_stillest_chunk_seconds")


def samples(live: Live) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    answer = live.client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].startswith("text/plain")
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def requests_to(live: Live, method: str, route: str, status: str) -> float:
    labels = (("method", method), ("route", route), ("status", status))
    return samples(live).get(("multicap_http_requests_total", labels), 0.0)


def test_requests_are_counted_by_route_not_by_address(live: Live) -> None:
    route = "/v1/jobs/{job_id}"
    before = requests_to(live, "GET", route, "404")
    for number in range(3):
        live.client.get(f"/v1/jobs/00000000-0000-0000-0000-00000000000{number}")
    assert requests_to(live, "GET", route, "404") == before + 3
    unknown = requests_to(live, "GET", "unknown", "404")
    odd = requests_to(live, "other", "unknown", "404")
    live.client.get("/no/such/path")
    live.client.get("/nor/this")
    raw(live.address, b"PURGE /pot HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    assert requests_to(live, "GET", "unknown", "404") == unknown + 2
    assert requests_to(live, "other", "unknown", "404") == odd + 1
    assert not any("no/such" in str(key) or "PURGE" in str(key) for key in samples(live))


def test_oldest_running_chunk_and_one_without_progress_are_named(live: Live) -> None:
    job_id = live.job_id()
    store = live.services.store
    oldest, stillest = store.leases.claim("one", 3600.0), store.leases.claim("two", 3600.0)
    assert oldest is not None
    assert stillest is not None
    store.leases.heartbeat(oldest.chunk_id, oldest.lease_token, oldest.unit_count, 3600.0)

    def running() -> dict[str, tuple[dict[str, str], float]]:
        return {name: (dict(labels), value) for (name, labels), value in samples(live).items() if name in OF_CHUNKS}

    assert running() == {}  # they have just begun
    with sqlite3.connect(live.settings.data_dir / "multicap.db") as database:
        begun = "UPDATE chunks SET claimed_at = claimed_at - ?, moved_at = moved_at - ? WHERE id = ?"
        database.execute(begun, [1000.0, 10.0, oldest.chunk_id])
        database.execute(begun, [500.0, 400.0, stillest.chunk_id])
    labels = {"tenant": "default", "job_id": job_id, "stage": oldest.stage}
    for name, claim, value in (
        ("multicap_oldest_chunk_seconds", oldest, 1000.0),
        ("multicap_oldest_chunk_progress", oldest, 1.0),
        ("multicap_stillest_chunk_seconds", stillest, 400.0),
    ):
        named, measured = running()[name]
        assert named == labels | {"chunk": str(claim.index)}
        assert measured == pytest.approx(value, rel=0.1)
    # Progress is what a heartbeat reports beyond the last one, and a heartbeat alone is none.
    store.leases.heartbeat(stillest.chunk_id, stillest.lease_token, 0, 3600.0)
    assert running()["multicap_stillest_chunk_seconds"][0]["chunk"] == str(stillest.index)
    store.leases.heartbeat(stillest.chunk_id, stillest.lease_token, 1, 3600.0)
    assert running()["multicap_stillest_chunk_seconds"][0]["chunk"] == str(oldest.index)


def test_jobs_are_counted(live: Live) -> None:
    waiting = live.job_id()
    found = samples(live)
    assert found["multicap_jobs", (("state", "queued"),)] == 1.0
    assert found["multicap_longest_queued_seconds", ()] >= 0.0
    ended = found.get(("multicap_jobs_ended_total", (("state", "succeeded"),)), 0.0)
    live.finish(waiting, each_chunk=True)
    found = samples(live)
    assert found["multicap_jobs_ended_total", (("state", "succeeded"),)] == ended + 1
    assert found["multicap_chunks_done_total", (("stage", "export"),)] >= 1
    assert found["multicap_chunk_units_total", (("stage", "detect"),)] >= 120
    assert ("multicap_jobs", (("state", "queued"),)) not in found
