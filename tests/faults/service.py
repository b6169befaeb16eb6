"""Service of the fault tests: it can restart with another version of its code, and its webhooks are recorded."""

import contextlib
import hmac
import json
import os
import shutil
import threading
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from numba.core.caching import _CacheLocator
from standardwebhooks import Webhook

from pipeline.core.runtime.kernel_cache import cache_folder
from pipeline.run.engine.code import digests_of_stages, stage_codes
from tests.e2e.serving import Served, serving
from worker.store.model.rights import DEFAULT_TENANT
from worker.store.store import JobStore

ROOT = Path(__file__).parents[2]
CLOCK_FOLDER = Path(__file__).parent / "clock"
PACKAGES = ("api", "pipeline", "worker")
# Module of what all stages read, which no kernel is compiled from.
READ_BY_ALL_STAGES = "pipeline/core/errors.py"
# Offset of the service's clock in seconds; see ``clock/sitecustomize.py``.
CLOCK = "clock"
ENVIRONMENT = {
    "MULTICAP_LEASE_S": "3",
    "MULTICAP_HEARTBEAT_S": "0.5",
    "MULTICAP_REAP_INTERVAL_S": "1",
    "MULTICAP_WEBHOOK_PRIVATE": "true",
}


@dataclass
class VerifyingReceiver:
    """Receiver of webhooks; it records the ids of messages by job and type."""

    port: int = 0
    secret: str = ""
    messages: dict[tuple[str, str], set[str]] = field(default_factory=lambda: defaultdict(set))
    forged: list[str] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook"

    def take(self, headers: dict[str, str], body: str) -> None:
        """Verify and record a message; its age is not checked, because clocks are changed."""
        message_id, sent_at = headers["webhook-id"], datetime.fromtimestamp(int(headers["webhook-timestamp"]), UTC)
        signature = Webhook(self.secret).sign(message_id, sent_at, body)
        if not any(hmac.compare_digest(signature, one) for one in headers["webhook-signature"].split()):
            self.forged.append(body)
            return
        message = json.loads(body)
        self.messages[message["data"]["id"], message["type"]].add(message_id)


@contextlib.contextmanager
def receiving() -> Iterator[VerifyingReceiver]:
    """Run a receiver on a free port during the block."""
    receiver = VerifyingReceiver()

    class VerifyingHandler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"])).decode()
            receiver.take({name.lower(): value for name, value in self.headers.items()}, body)
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), VerifyingHandler) as server:
        receiver.port = server.server_port
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield receiver
        server.shutdown()


class SmallDiskService:
    """A running service on a small disk.

    Parameters
    ----------
    disk
        The disk; its data folder is ``data`` there.
    receiver
        Gets the webhooks of all jobs.
    """

    def __init__(self, disk: Path, receiver: VerifyingReceiver) -> None:
        self.disk, self.receiver = disk, receiver
        self.data_dir = disk / "data"
        self.filler = self.data_dir / "filler"
        # SHA-256 of the last job's result files in a restored copy of the service.
        self.restored: dict[str, str] = {}
        self.served: Served
        self._code = ROOT
        self._running = contextlib.ExitStack()

    def start(self) -> None:
        self.served = self._running.enter_context(serving(self.data_dir, **self.environment()))

    def stop(self) -> None:
        self._running.close()

    def upgrade(self, folder: Path) -> None:
        """Restart with the other version of all stages, or with our version again."""
        self.stop()
        self._code = ROOT if self._code != ROOT else other_version(folder)
        self.start()

    def environment(self) -> dict[str, str]:
        path = os.pathsep.join([str(CLOCK_FOLDER), str(self._code)])
        return {**ENVIRONMENT, "PYTHONPATH": path, "MULTICAP_TEST_CLOCK": str(self.disk / CLOCK)}

    def make_webhook_secret(self) -> None:
        store = JobStore(f"sqlite:///{self.data_dir / 'multicap.db'}")
        self.receiver.secret = store.webhook_secrets.rotate(DEFAULT_TENANT, 0.0)
        store.close()


def other_version(folder: Path) -> Path:
    """Copy of the code in which all stages have another version and the same results.

    Its kernels are the same, and are not compiled again: numba's cache holds those of each folder of sources apart.
    """
    if not folder.exists():
        for package in PACKAGES:
            shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
        with (folder / READ_BY_ALL_STAGES).open("a", encoding="utf-8") as file:
            file.write("\nUNUSED = 1\n")
        _copy_kernels(folder)
        codes = digests_of_stages(folder)
        assert all(codes[stage] != code for stage, code in stage_codes().items())
    return folder


def _copy_kernels(folder: Path) -> None:
    """Copy the compiled kernels of our sources to where those of a copy of them are looked for."""
    cache = cache_folder()
    assert cache is not None
    for source in {path.parent for path in (ROOT / "pipeline").rglob("*.py")}:
        ours, others = (
            cache / _CacheLocator.get_suitable_cache_subpath(str(place / "module.py"))  # type: ignore[no-untyped-call]
            for place in (source, folder / source.relative_to(ROOT))
        )
        if ours.is_dir():
            shutil.copytree(ours, others, dirs_exist_ok=True)
