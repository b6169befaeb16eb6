"""Metrics, read by Prometheus' own parser."""

from prometheus_client.parser import text_string_to_metric_families

from tests.api.conftest import Live, raw


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


def test_requests_are_counted_by_route_not_by_what_strangers_call(live: Live) -> None:
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
