"""Traces by OpenTelemetry, from a request to the chunks of its job; off without an endpoint.

The standard environment variables configure them: ``OTEL_EXPORTER_OTLP_ENDPOINT`` turns traces on;
``OTEL_SERVICE_NAME``, ``OTEL_TRACES_SAMPLER`` and the others have their usual meanings. OpenTelemetry's SDK is imported
only with an endpoint: it would take a tenth of the start of a service.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping

from opentelemetry import trace
from opentelemetry.propagate import extract, inject
from opentelemetry.trace import Link, Span, SpanKind

from worker.store.model.work import Claim

_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")

_tracer = trace.get_tracer("multicap")


def is_wanted() -> bool:
    """True if an endpoint for traces is configured."""
    return any(os.environ.get(name) for name in _ENDPOINTS)


def start(service_name: str) -> None:
    """Export this process's spans from now on, if an endpoint is configured; to be called again after a fork."""
    if is_wanted():
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415
        from opentelemetry.sdk.resources import SERVICE_NAME, Resource  # noqa: PLC0415
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415

        named = "OTEL_SERVICE_NAME" in os.environ
        resource = Resource.create() if named else Resource.create({SERVICE_NAME: service_name})
        provider = TracerProvider(resource=resource)
        provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
        trace.set_tracer_provider(provider)


def stop() -> None:
    """Export the remaining spans."""
    if is_wanted():
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415

        provider = trace.get_tracer_provider()
        if isinstance(provider, TracerProvider):
            provider.shutdown()


def current() -> str | None:
    """W3C traceparent of the current span; ``None`` without a trace."""
    carrier: dict[str, str] = {}
    inject(carrier)
    return carrier.get("traceparent")


@contextlib.contextmanager
def message_span(headers: Mapping[str, str]) -> Iterator[None]:
    """Trace the work that a message starts, as part of the trace that published the message."""
    with _tracer.start_as_current_span("work", context=extract(headers), kind=SpanKind.CONSUMER):
        yield


@contextlib.contextmanager
def chunk_span(claim: Claim) -> Iterator[Span]:
    """Trace a chunk, as part of the trace that created its job, with a link to the message that started the work."""
    woken_by = trace.get_current_span().get_span_context()
    with _tracer.start_as_current_span(
        claim.stage,
        context=extract({"traceparent": claim.trace} if claim.trace else {}),
        links=[Link(woken_by)] if woken_by.is_valid else [],
        attributes={
            "multicap.session": claim.session_id,
            "multicap.job": claim.job_id,
            "multicap.stage": claim.stage,
            "multicap.chunk": claim.index,
            "multicap.chunk_try": claim.attempt,
            "multicap.units": claim.unit_count,
        },
    ) as span:
        yield span
