"""Receivers of webhooks on loopback, good and bad, and a bench whose jobs end with a message."""

import contextlib
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.worker.conftest import RunnerBench
from worker.run.planning import plan_job
from worker.run.webhooks.sender import Courier, Sender
from worker.store.database.connection import now
from worker.store.database.tables import deliveries
from worker.store.model.job_records import Delivery, JobRecord, WebhookSecret
from worker.store.spec import JobSpec

HOUR_S = 3600.0


@dataclass
class Receiver:
    """Server of a client that receives webhooks."""

    port: int
    statuses: list[int] = field(default_factory=list)  # statuses of the next answers; then 204
    received: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook?x=1"


@contextlib.contextmanager
def receiving(context: ssl.SSLContext | None = None) -> Iterator[Receiver]:
    class WebhookHandler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            found.received.append(({name.lower(): value for name, value in self.headers.items()}, body))
            found.paths.append(self.path)
            self.send_response(found.statuses.pop(0) if found.statuses else 204)
            self.send_header("Location", "/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), WebhookHandler) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        found = Receiver(server.server_address[1])
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield found
        server.shutdown()
        thread.join()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as found:
        yield found


def end_job(bench: RunnerBench, url: str) -> JobRecord:
    """Run a job with a callback URL to its end."""
    spec = JobSpec(callback_url=url)
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(replace(bench.session, chunk_frames=1000), spec))
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


def deliver(bench: RunnerBench, sender: Sender | None = None) -> int:
    with ThreadPoolExecutor(16) as pool:
        return Courier(bench.store, sender or Sender(allow_private=True), pool).start_due()


def make_due(bench: RunnerBench) -> None:
    with bench.store._database.writing() as connection:
        connection.execute(deliveries.update().values(due_at=0.0))


def message(url: str) -> Delivery:
    return Delivery(1, "msg_1", "0190", "default", url, "{}", None, 1, None)  # type: ignore[arg-type]


def secret() -> list[WebhookSecret]:
    return [WebhookSecret("whsec_c2VjcmV0", None, None)]  # type: ignore[arg-type]


def queue_for(bench: RunnerBench, tenant: str, url: str) -> None:
    """Queue a message of a tenant that is due now."""
    if not bench.store.webhooks.pending():
        end_job(bench, "https://hook.example/")
        with bench.store._database.writing() as connection:
            connection.execute(deliveries.update().values(tenant=tenant, url=url))
        return
    with bench.store._database.writing() as connection:
        row = connection.execute(deliveries.select().limit(1)).one()._asdict()
        del row["id"]
        new = {"tenant": tenant, "url": url, "tries": 0, "created_at": now(), "due_at": now()}
        connection.execute(deliveries.insert().values(row | new))


@contextlib.contextmanager
def listening(answer: Callable[[socket.socket, threading.Event], None]) -> Iterator[str]:
    """Serve all connections with ``answer``; yield the address."""
    over, threads = threading.Event(), []

    def serve_one(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            answer(connection, over)

    def serve(server: socket.socket) -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threads.append(threading.Thread(target=serve_one, args=[connection]))
            threads[-1].start()

    server = socket.create_server(("127.0.0.1", 0))
    threads.append(threading.Thread(target=serve, args=[server]))
    threads[0].start()
    yield f"http://127.0.0.1:{server.getsockname()[1]}/"
    over.set()
    server.shutdown(socket.SHUT_RDWR)
    server.close()
    for thread in threads:
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def silent() -> Iterator[str]:
    """Address of a server that accepts connections and never answers."""

    def answer(_: socket.socket, over: threading.Event) -> None:
        over.wait(60)

    with listening(answer) as address:
        yield address


@pytest.fixture
def flooding() -> Iterator[Callable[[bytes], str]]:
    """Start servers whose headers have no end."""
    with contextlib.ExitStack() as stack:

        def start(piece: bytes) -> str:
            def answer(connection: socket.socket, over: threading.Event) -> None:
                connection.sendall(b"HTTP/1.1 200 OK\r\n" if piece.startswith(b"X") else b"")
                while not over.is_set():
                    connection.sendall(piece)

            return stack.enter_context(listening(answer))

        yield start


@pytest.fixture
def closing() -> Iterator[Callable[[bytes], str]]:
    """Start servers that send some bytes and close the connection."""
    with contextlib.ExitStack() as stack:
        yield lambda said: stack.enter_context(listening(lambda connection, _: connection.sendall(said)))


@pytest.fixture
def dripping() -> Iterator[Callable[[bytes], str]]:
    """Start servers that answer one byte at a time, without end."""
    servers, over = [], threading.Event()

    def serve(listening: socket.socket, first: bytes) -> None:
        try:
            connection, _ = listening.accept()
            with connection:
                connection.sendall(first)
                while not over.wait(0.02):
                    connection.sendall(b"x")
        except OSError:
            return

    def start(first: bytes) -> str:
        listening = socket.create_server(("127.0.0.1", 0))
        listening.settimeout(20)
        servers.append((listening, threading.Thread(target=serve, args=[listening, first])))
        servers[-1][1].start()
        return f"http://127.0.0.1:{listening.getsockname()[1]}/"

    yield start
    over.set()
    for listening, thread in servers:
        listening.close()
        thread.join()
