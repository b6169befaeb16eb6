"""``python -m api [--fd N]``: the web API alone, as its environment says."""

import argparse
import socket
import sys

import uvicorn
from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor

from api.app import ExposedError, create_app, refuse_strangers
from api.connections import bounded_protocol
from api.settings import Settings
from worker import tracing
from worker.jobs.store import JobStore
from worker.logs import configure_logs
from worker.settings import read_settings

# How long open requests may go on after SIGTERM.
_GRACE_S = 5
_SWITCH_S = 0.001
# Those who watch the service ask all the time.
_NOT_TRACED = "healthz,readyz,metrics"


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(prog="python -m api", description="Serve the web API.")
    parser.add_argument("--fd", type=int, help="An inherited socket that listens, instead of MULTICAP_HOST and _PORT.")
    fd = parser.parse_args().fd
    configure_logs()
    settings = read_settings(Settings)
    _refuse_strangers(settings)
    # An answer needs the interpreter again and again: threads that take in uploads have to hand it over sooner.
    sys.setswitchinterval(_SWITCH_S)
    app = create_app(settings)
    tracing.start("multicap-api")
    if tracing.is_wanted():
        # Uploads come in a great many pieces; a span each would say nothing.
        FastAPIInstrumentor.instrument_app(app, excluded_urls=_NOT_TRACED, exclude_spans=["receive", "send"])
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=bounded_protocol(settings.client_idle_s),
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=_GRACE_S,
        log_level="warning",
    )
    uvicorn.Server(config).run(sockets=None if fd is None else [socket.socket(fileno=fd)])
    tracing.stop()


def _refuse_strangers(settings: Settings) -> None:
    if not settings.is_exposed:
        return
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    store = JobStore(settings.resolved_database_url)
    try:
        store.migrate()
        refuse_strangers(settings, store)
    except ExposedError as error:
        sys.exit(f"error: {error}")
    finally:
        store.close()


if __name__ == "__main__":
    main()
