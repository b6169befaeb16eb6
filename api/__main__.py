"""``python -m api [--fd N]``: the web API alone, as its environment says."""

import argparse
import socket

import uvicorn

from api.app import create_app
from api.settings import Settings
from worker.logs import configure_logs

# How long open requests may go on after SIGTERM.
_GRACE_S = 5


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(prog="python -m api", description="Serve the web API.")
    parser.add_argument("--fd", type=int, help="An inherited socket that listens, instead of MULTICAP_HOST and _PORT.")
    fd = parser.parse_args().fd
    configure_logs()
    settings = Settings()
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=_GRACE_S,
        log_level="warning",
    )
    uvicorn.Server(config).run(sockets=None if fd is None else [socket.socket(fileno=fd)])


if __name__ == "__main__":
    main()
