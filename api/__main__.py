"""``python -m api [--fd N]``: run the web API alone, configured by environment variables."""

import argparse
import contextlib
import gc
import socket
import ssl
import sys

import uvicorn
from filelock import FileLock, Timeout
from sqlalchemy.exc import SQLAlchemyError

from api.web.app import create_app
from api.web.http.server import server_config
from api.web.settings import Settings
from api.web.startup import ExposedError, require_keys_if_exposed, unusable_database
from worker.run import tracing
from worker.run.logs import configure_logs
from worker.run.settings import read_settings
from worker.store.errors import UnknownSchema
from worker.store.files.disk import DiskSpace, keep_files_private, make_private
from worker.store.store import JobStore

_SWITCH_S = 0.001
# Monitoring requests these addresses every few seconds.
_NOT_TRACED = "healthz,readyz,metrics"


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(prog=f"python -m {__package__}", description="Serve the web API.")
    parser.add_argument(
        "--fd", type=int, help="Inherited listening socket, in place of MULTICAP_HOST and MULTICAP_PORT."
    )
    fd = parser.parse_args().fd
    keep_files_private()
    settings = read_settings(Settings)
    configure_logs(settings.log_level)
    lock = _locked(settings)  # until this process ends
    try:
        make_private(settings.data_dir)
        with contextlib.closing(JobStore(settings.resolved_database_url)) as store:
            DiskSpace(settings.data_dir).using_reserve(store.migrate)
            require_keys_if_exposed(settings, store)
    except (ExposedError, UnknownSchema) as error:
        sys.exit(f"error: {error}")
    except (SQLAlchemyError, ImportError, OSError) as error:  # ImportError: no driver for the URL's database
        sys.exit(f"error: {unusable_database(settings, error)}")
    _check_certificate(settings)
    # A response needs the interpreter lock many times: threads that receive uploads have to release it sooner.
    sys.setswitchinterval(_SWITCH_S)
    app = create_app(settings)
    tracing.start("multicap-api")
    if tracing.is_wanted():
        from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor  # noqa: PLC0415 - slow to import

        # An upload arrives in thousands of pieces: a span for each piece would tell nothing.
        FastAPIInstrumentor.instrument_app(app, excluded_urls=_NOT_TRACED, exclude_spans=["receive", "send"])
    # Loaded modules stay: full collections of garbage, which hold up all answers, need not look through them.
    gc.freeze()
    uvicorn.Server(server_config(app, settings)).run(sockets=None if fd is None else [socket.socket(fileno=fd)])
    tracing.stop()
    lock.release()


def _locked(settings: Settings) -> FileLock:
    """Lock the data folder against other API processes, which would empty its spool; exit with a message if it is."""
    lock = FileLock(settings.data_dir / "api.lock", timeout=0)
    try:
        make_private(settings.data_dir)
        lock.acquire()
    except Timeout:
        sys.exit(
            f"error: Another API process runs on the folder {settings.data_dir}. Stop it, or give each process a "
            "MULTICAP_DATA_DIR of its own."
        )
    except OSError as error:
        sys.exit(f"error: The folder {settings.data_dir} can't be used: {error.strerror}. Choose another folder.")
    return lock


def _check_certificate(settings: Settings) -> None:
    """Exit with a message if the certificate can't be used."""
    if settings.certificate is None or settings.certificate_key is None:
        return
    try:
        # A key with a password would be asked for at a terminal.
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(settings.certificate, settings.certificate_key, password=lambda: "")
    except (OSError, ValueError):
        names = "MULTICAP_CERTIFICATE and MULTICAP_CERTIFICATE_KEY"
        sys.exit(f"error: {names} must name readable PEM files that belong together, the key without a password.")


if __name__ == "__main__":
    main()
