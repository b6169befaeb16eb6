"""S3 server for tests."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import httpx2
import uuid_utils

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.ports import free_port


@dataclass
class S3:
    """Running server with a new bucket."""

    process: subprocess.Popen[bytes]
    endpoint: str
    bucket: str

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables for clients of the server."""
        return {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",  # nobody asks for another
            "AWS_REGION": "us-east-1",
        }

    def new_url(self) -> str:
        """URL of an empty prefix in the bucket."""
        return f"s3://{self.bucket}/{uuid_utils.uuid4().hex}"


@contextlib.contextmanager
def running_s3() -> Iterator[S3]:
    port = free_port()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    command = tied_to_parent([sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)])
    with subprocess.Popen(command, env=os.environ, **quiet) as process:  # type: ignore[call-overload]
        server = S3(process, f"http://127.0.0.1:{port}", "multicap")
        try:
            deadline_s = time.monotonic() + 120
            while True:
                assert process.poll() is None
                assert time.monotonic() < deadline_s
                with contextlib.suppress(httpx2.TransportError):
                    httpx2.put(f"{server.endpoint}/{server.bucket}", timeout=180, trust_env=False).raise_for_status()
                    break
                time.sleep(0.05)
            yield server
        finally:
            process.terminate()
