"""Trace of a job at a collector: from the request to every chunk."""

import threading
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from tests.e2e.serving import serving
from tests.e2e.test_serve_keypoints import capture, files
from tests.waiting import wait_for

__all__ = ["capture"]


@dataclass
class Collector:
    """Received spans by their ids, and the services that sent them."""

    spans: dict[bytes, Any] = field(default_factory=dict)
    services: dict[bytes, str] = field(default_factory=dict)

    def take(self, body: bytes) -> None:
        for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
            service = {one.key: one.value.string_value for one in resource.resource.attributes}["service.name"]
            for scope in resource.scope_spans:
                for span in scope.spans:
                    self.services[span.span_id] = service
                    self.spans[span.span_id] = span

    def trace_of(self, name: str) -> dict[bytes, Any]:
        """All spans of the trace that contains the only span with a name."""
        (root,) = [span for span in list(self.spans.values()) if span.name == name]
        return {key: span for key, span in list(self.spans.items()) if span.trace_id == root.trace_id}


@pytest.fixture
def collector() -> Iterator[tuple[Collector, str]]:
    """Collector of OTLP over HTTP with its address."""
    found = Collector()

    class TraceHandler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            found.take(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), TraceHandler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield found, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def attributes(span: Any) -> dict[str, str | int | bool]:
    return {one.key: getattr(one.value, one.value.WhichOneof("value")) for one in span.attributes}


def test_job_is_one_trace(collector: tuple[Collector, str], capture: Path, tmp_path: Path) -> None:
    found, address = collector
    with serving(tmp_path, 1, OTEL_EXPORTER_OTLP_ENDPOINT=address, OTEL_BSP_SCHEDULE_DELAY="200") as served:
        job_id = served.client.post("/v1/jobs", files=files(capture)).raise_for_status().json()["id"]
        stages = {stage["name"] for stage in served.wait_for_end(job_id)["stages"]}
        wait_for(lambda: stages <= {span.name for span in list(found.spans.values())})
    spans = found.trace_of("POST /v1/jobs")
    by_name: dict[str, list[Any]] = defaultdict(list)
    for span in spans.values():
        by_name[span.name].append(span)
    (request,) = by_name["POST /v1/jobs"]
    assert request.parent_span_id == b""
    assert found.services[request.span_id] == "multicap-api"
    # Through the database: chunks are children of the request that created the job ...
    for stage in stages:
        for span in by_name[stage]:
            assert span.parent_span_id == request.span_id
            assert (attributes(span)["multicap.job"], attributes(span)["multicap.stage"]) == (job_id, stage)
            assert found.services[span.span_id] == "multicap-worker"
            # ... and link to the message that started their worker.
            assert len(span.links) == 1
    # Through the broker: the request published a message, which a worker received.
    publishing = {span.span_id for span in by_name["publish"] if span.parent_span_id == request.span_id}
    assert publishing & {span.parent_span_id for span in by_name["work"]}
    assert by_name["preflight"][0].parent_span_id == request.span_id
    # Requests of monitoring are not traced.
    assert not [span for span in found.spans.values() if "/readyz" in span.name]
    log = (tmp_path / "logs" / "worker.log").read_text()
    assert log.count(f'"trace_id": "{request.trace_id.hex()}"') >= len(stages)
