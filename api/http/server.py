"""The HTTP server around the app: limits on connections, and which proxies it believes."""

from fastapi import FastAPI
from uvicorn import Config

from api.http.connections import Connections, bounded_protocol
from api.settings import Settings
from worker.process.descriptors import raise_descriptor_limit

# How long open requests may go on after SIGTERM.
_GRACE_S = 5
# Kept for the database, files, and children.
_OWN_DESCRIPTORS = 256
# A connection's own, and one of a file that is received or sent.
_DESCRIPTORS_A_CONNECTION = 2


def server_config(app: FastAPI, settings: Settings) -> Config:
    """Configure the server, and raise this process's limit on open files to what it may be."""
    descriptors = raise_descriptor_limit()
    own = min(_OWN_DESCRIPTORS, descriptors // 2)
    room = max(1, (descriptors - own) // _DESCRIPTORS_A_CONNECTION)
    proxies = settings.trusted_proxies
    connections = Connections(min(settings.max_connections, room), settings.max_client_connections, proxies)
    return Config(
        app,
        host=settings.host,
        port=settings.port,
        http=bounded_protocol(settings.client_idle_s, connections),
        ws="none",
        proxy_headers=bool(proxies),
        forwarded_allow_ips=[str(network) for network in proxies],
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=_GRACE_S,
        log_config=None,
    )
