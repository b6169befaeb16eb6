"""`multicap serve`: run the service on this machine: web API, workers, reaper and broker under a supervisor."""

import os
import socket
import threading
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from api.cli.console import console, refusal, reporting, shows_help
from api.cli.options import ProviderOption, take_provider
from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.resources import raise_descriptor_limit
from worker.run.supervisor import Program, Supervisor
from worker.store.spec import JobSpec

if not shows_help():
    import httpx2

    from api.cli.certificates import CertificateError, Encryption, given_encryption, own_encryption
    from api.cli.served import READY
    from api.cli.store import opened_store
    from api.web.settings import Settings
    from api.web.startup import ExposedError, require_keys_if_exposed
    from pipeline.detection import models
    from worker.run import embedded
    from worker.run.presence import remove_killed
    from worker.store.files.disk import keep_files_private
    from worker.store.repositories.keys import Keys

_POLL_S = 0.2
# A usual start takes less; a longer start is explained.
_QUIET_S = 2.0
_EXPLAIN_EVERY_S = 5.0

_ALL_ADDRESSES = "0.0.0.0"  # noqa: S104 - with keys alone
# Addresses by which this machine reaches a service that listens on all addresses.
_LOOPBACK_OF = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - a table of names


def _listen(host: str, port: int) -> socket.socket:
    """Open a listening socket in this process, so that a restart of the API keeps the port and refuses no client."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=512)
    except OSError as error:
        sentence = f"Port {port} can't be used on {host}: {error.strerror}. Choose another port with --port."
        raise refusal(sentence) from error


def _url(host: str, port: int, scheme: str) -> str:
    """Address by which this machine reaches the service."""
    name = _LOOPBACK_OF.get(host, host)
    return f"{scheme}://[{name}]:{port}" if ":" in name else f"{scheme}://{name}:{port}"


def _api(
    directory: "embedded.DataDirectory", settings: "Settings", listening: socket.socket, encryption: "Encryption | None"
) -> Program:
    fd, port = listening.fileno(), listening.getsockname()[1]
    command = module_command("api", "--fd", str(fd))
    environment = directory.environment() | {"MULTICAP_HOST": settings.host}
    if encryption is not None:
        environment |= encryption.environment(port, sorted(settings.allowed_hosts), settings.public_url)
    return Program("api", command, environment, pass_fds=[fd])


def _announce(url: str, encryption: "Encryption | None", public_url: str | None) -> None:
    """Print the address as soon as the service is ready; until then, explain every few seconds what is missing."""
    explain_at_s, explained = time.monotonic() + _QUIET_S, ""
    trusted = True if encryption is None else encryption.client_context()
    with httpx2.Client(base_url=url, timeout=5.0, trust_env=False, verify=trusted) as client:
        while (missing := _missing(client)) != "":
            if missing not in {None, explained} and time.monotonic() >= explain_at_s:
                console.print(missing, markup=False, highlight=False, soft_wrap=True)
                explain_at_s, explained = time.monotonic() + _EXPLAIN_EVERY_S, missing
            time.sleep(_POLL_S)
    typer.echo(f"{READY}{url}")
    if encryption is not None and encryption.has_replaced:
        console.print("The certificate is new. Phones that trusted the earlier one ask again.", highlight=False)
    if public_url is not None:
        console.print(f"Phones open {public_url}.", markup=False, highlight=False, soft_wrap=True)
    console.print("Ctrl-C stops it.")


def _missing(client: "httpx2.Client") -> str | None:
    """Sentences about what the service is waiting for; empty if it is ready, ``None`` if it does not respond."""
    try:
        answer = client.get("/readyz")
        if answer.is_success:
            return ""
        problem = answer.json()
        items = [" ".join(filter(None, [item["message"], item["hint"]])) for item in problem["errors"]]
        return " ".join(items) or str(problem["detail"])
    except (httpx2.TransportError, ValueError, KeyError):
        return None


def command(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for a free one.")] = 8000,
    host: Annotated[
        str | None,
        typer.Option(
            help="Address to listen on; without keys only loopback. Default: 127.0.0.1, with --https all addresses.",
            show_default=False,
        ),
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data folder of the service; created if it is missing.")] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=256,
            help="Number of worker processes. Default: one for each processor, plus one if there are several tenants.",
        ),
    ] = None,
    provider: ProviderOption = None,
    https: Annotated[
        bool,
        typer.Option("--https", help="Encrypt by a certificate of the service's own: phones need it for cameras."),
    ] = False,
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate of your own in PEM, in place of the service's; with its key.")
    ] = None,
    certificate_key: Annotated[
        Path | None, typer.Option(help="Private key of --certificate in PEM, without a password.")
    ] = None,
) -> None:
    """Run the service on this machine: web API, workers, broker and database, until Ctrl-C."""
    if (certificate is None) != (certificate_key is None):
        raise refusal("A certificate and its key belong together: give --certificate and --certificate-key.")
    is_encrypted = https or certificate is not None
    listening_host = host or (_ALL_ADDRESSES if is_encrypted else "127.0.0.1")
    settings = Settings(host=listening_host) if data is None else Settings(host=listening_host, data_dir=data)
    keep_files_private()
    raise_descriptor_limit()
    with reporting(as_json=False):
        take_provider(provider)
        for name in JobSpec().config.networks.names:
            models.verify(name)
    try:
        with embedded.lock(settings.data_dir) as directory:
            with opened_store(settings) as store:
                require_keys_if_exposed(settings, store)
                remove_killed(store.workers)
                default_workers = _default_workers(store.keys)
            encryption = None
            if certificate is not None and certificate_key is not None:
                encryption = given_encryption(certificate, certificate_key)
            elif https:
                encryption = own_encryption(settings.data_dir)
            _serve(settings, directory, port, workers or default_workers, encryption)
    except (embedded.DataFolderError, ExposedError, CertificateError) as error:
        raise refusal(str(error)) from error
    console.print("Stopped.")


def _default_workers(keys: "Keys") -> int:
    # One worker stays free for the other tenants, see `worker.store.repositories.work.next_chunk`.
    return (os.cpu_count() or 1) + (keys.count_tenants() > 1)


def _serve(
    settings: "Settings", directory: "embedded.DataDirectory", port: int, workers: int, encryption: "Encryption | None"
) -> None:
    with _listen(settings.host, port) as listening:
        api = _api(directory, settings, listening, encryption)
        url = _url(settings.host, listening.getsockname()[1], "http" if encryption is None else "https")
        public_url = None if encryption is None else api.env["MULTICAP_PUBLIC_URL"]
        threading.Thread(target=_announce, args=[url, encryption, public_url], daemon=True).start()
        programs = [
            embedded.broker(directory),
            embedded.worker(directory, workers),
            embedded.reaper(directory),
            api,
        ]
        Supervisor(programs, directory.logs_dir, _warn).run()


def _warn(sentence: str) -> None:
    console.print(Text.assemble(("warning ", "yellow"), sentence), soft_wrap=True)
