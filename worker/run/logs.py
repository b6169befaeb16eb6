"""Logs on stderr, one JSON object a line, for events of Multicap and of its libraries.

The parent process stores the lines: the supervisor of ``multicap serve`` in rotated files
(``worker.run.supervisor``), a container engine in its own log. A line that can't be written, on a full disk or
to a closed pipe, is lost; the work continues.
"""

import contextlib
import logging
import os
import sys
import threading
from types import TracebackType
from typing import Any, Literal

import structlog
from opentelemetry import trace
from structlog.typing import EventDict

LogLevel = Literal["debug", "info", "warning", "error"]

_STDERR = 2
# Largest length of one text in a line: clients may send paths and names of any length.
_MAX_TEXT = 4000


def configure_logs(level: LogLevel = "info") -> None:
    """Set up this process's log.

    ``level`` is the lowest one of Multicap's events that are written; events of libraries are written from ``warning``
    on.
    """
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        _add_trace,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
        _cut_texts,
    ]
    renderer = structlog.processors.JSONRenderer(sort_keys=True)
    severity = getattr(logging, level.upper())
    structlog.configure(
        processors=[*shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(severity),
        logger_factory=lambda *_: _Stderr(),
    )
    handler = _StderrHandler()
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *shared, renderer],
        )
    )
    logging.basicConfig(handlers=[handler], level=max(severity, logging.WARNING), force=True)
    logging.captureWarnings(True)
    sys.excepthook = _log_crash
    threading.excepthook = _log_thread_crash


def write_line(line: str) -> None:
    """Write a line to stderr; a line that can't be written is lost."""
    data = line.encode(errors="backslashreplace") + b"\n"
    with contextlib.suppress(OSError):
        while data:
            data = data[os.write(_STDERR, data) :]


class _Stderr:
    """Logger for structlog: every level writes the line that the processors rendered."""

    def msg(self, message: str) -> None:
        write_line(message)

    debug = info = warning = error = exception = critical = msg


class _StderrHandler(logging.Handler):
    """Handler for the standard library's loggers, which libraries use."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(Exception):  # a malformed record of a library must not stop the work
            write_line(self.format(record))


def _add_trace(logger: object, name: str, event: EventDict) -> EventDict:
    span = trace.get_current_span().get_span_context()
    if span.is_valid:
        event["trace_id"] = trace.format_trace_id(span.trace_id)
        event["span_id"] = trace.format_span_id(span.span_id)
    return event


def _cut_texts(logger: object, name: str, event: EventDict) -> EventDict:
    """Shorten long texts: keep the end of a traceback, which states the error, and the beginning of other texts."""
    for key, value in event.items():
        if isinstance(value, str) and len(value) > _MAX_TEXT:
            event[key] = f"[...]{value[-_MAX_TEXT:]}" if key == "exception" else f"{value[:_MAX_TEXT]}[...]"
    return event


def _log_crash(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        structlog.get_logger().critical("crashed", exc_info=(kind, error, traceback))


def _log_thread_crash(args: threading.ExceptHookArgs) -> None:
    if args.exc_value is not None and args.exc_type is not SystemExit:
        _log_crash(args.exc_type, args.exc_value, args.exc_traceback)
