"""Client of ``containers.sh``, run in the image: sends the sample, waits, compares results with a quiet run's.

``take.py begin URL``, ``take.py continue URL UPLOAD PART``, ``take.py send URL [UPLOAD]``,
``take.py finish URL JOB EXPECTED``, ``take.py watch URL``, ``take.py crowd URL``; the key is in ``KEY``.
"""

import base64
import contextlib
import hashlib
import os
import socket
import ssl
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from urllib.parse import urlsplit

import httpx2

from multicap.api.cli.client import Client

SAMPLE = Path("/sample")
# File that appears when ``watch`` is to end.
END = Path("/watch/end")
TUS = {"Tus-Resumable": "1.0.0"}
# Idle connections at a time, and the time in which the proxy ends one that brings no request.
NUM_IDLE, SILENT_S = 1500, 60.0
# Time in which a body that trickles is answered: CLIENT_IDLE_S and a busy machine.
TRICKLING_S = 180.0


def connect(url: str) -> Client:
    """Client with the key of the environment."""
    return Client.connect(url, os.environ.get("KEY") or None, timeout_s=120)


def create(http: httpx2.Client, path: Path) -> str:
    """Begin the upload of a file by tus, and return its id."""
    name = base64.b64encode(path.name.encode()).decode()
    head = {"Upload-Length": str(path.stat().st_size), "Upload-Metadata": f"filename {name}"}
    answer = http.post("/v1/uploads", headers=TUS | head).raise_for_status()
    return answer.headers["location"].rpartition("/")[2]


def patch(http: httpx2.Client, upload_id: str, offset: int, content: bytes | Iterator[bytes]) -> httpx2.Response:
    """Send a piece of an upload."""
    head = {"Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
    return http.patch(f"/v1/uploads/{upload_id}", content=content, headers=TUS | head)


def upload(http: httpx2.Client, path: Path) -> str:
    """Send a file in pieces: the proxy leads them to one API process after another."""
    upload_id, offset = create(http, path), 0
    with path.open("rb") as file:
        while piece := file.read(2**20):
            patch(http, upload_id, offset, piece).raise_for_status()
            offset += len(piece)
    return upload_id


def begin(url: str) -> None:
    """Begin the upload of the first video, and print its id."""
    with connect(url) as client:
        sys.stdout.write(f"{create(client.http, videos()[0])}\n")


def continue_upload(url: str, upload_id: str, part: str) -> None:
    """Send a third of the first video: a piece whose connection is cut in its midst, and then what is missing."""
    data = videos()[0].read_bytes()
    end = len(data) * int(part) // 3
    with connect(url) as client:
        start = offset(client.http, upload_id)
        with contextlib.suppress(ConnectionAbortedError):
            patch(client.http, upload_id, start, cut(data[start : (start + end) // 2]))
        first = kept = offset(client.http, upload_id)
        end_s = time.monotonic() + 120
        while kept < end:
            answer = patch(client.http, upload_id, kept, data[kept:end])
            if answer.is_error and time.monotonic() > end_s:
                sys.exit(answer.text)
            kept = offset(client.http, upload_id)  # the request that was cut may have stored more
        sys.stdout.write(f"upload: {start} bytes were there, {first} after a cut, {kept} of {len(data)} now\n")


def offset(http: httpx2.Client, upload_id: str) -> int:
    """Bytes of an upload that the service has."""
    return int(http.head(f"/v1/uploads/{upload_id}", headers=TUS).raise_for_status().headers["Upload-Offset"])


def cut(data: bytes) -> Iterator[bytes]:
    """Pieces of a body of which the last does not come."""
    for start in range(0, len(data), 2**16):
        yield data[start : start + 2**16]
    time.sleep(3)  # the service has stored what came two seconds before
    raise ConnectionAbortedError


def videos() -> list[Path]:
    """Videos of the sample."""
    return sorted((SAMPLE / "videos").iterdir())


def send(url: str, *first: str) -> None:
    """Upload the sample, of which the first video may be there, begin a job, and print its id."""
    with connect(url) as client:
        ids = [*first, *(upload(client.http, path) for path in videos()[len(first) :])]
        (calibration,) = (SAMPLE / "calibration").iterdir()
        body = {"videos": ids, "calibration": upload(client.http, calibration)}
        answer = client.http.post("/v1/jobs", json=body)
        if answer.is_error:
            sys.exit(answer.text)
        sys.stdout.write(f"{answer.json()['id']}\n")


def finish(url: str, job_id: str, expected: str) -> None:
    """Wait for a job, and compare its results with the files of a folder."""
    with connect(url) as client, tempfile.TemporaryDirectory() as folder:
        job = client.follow(client.get(f"/v1/jobs/{job_id}"), timeout_s=1800)
        client.download(job, folder)
        digests = [
            {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in Path(results).iterdir()}
            for results in (folder, expected)
        ]
        if digests[0] != digests[1] or not digests[0]:
            sys.exit(f"The results differ: {set(digests[0].items()) ^ set(digests[1].items())}")
        for path in Path(expected).iterdir():
            answer = client.http.get(f"/v1/jobs/{job_id}/results/{path.name}", headers={"Range": "bytes=100-299"})
            if answer.status_code != 206 or answer.content != path.read_bytes()[100:300]:
                sys.exit(f"a range of {path.name}: status {answer.status_code}, {len(answer.content)} bytes")
        sys.stdout.write(f"{len(digests[0])} files of job {job_id}: the bytes of the quiet run, also of ranges.\n")


def watch(url: str) -> None:
    """Ask without a pause, with and without a key, until a file says the end; every answer must come."""
    answers, longest_s = 0, 0.0
    while not END.exists():
        for key in (os.environ.get("KEY"), None):
            with Client.connect(url, key, timeout_s=60) as client:
                start_s = time.monotonic()
                status = client.http.get("/v1/jobs" if key else "/healthz").status_code
                longest_s = max(longest_s, time.monotonic() - start_s)
                if status != 200:
                    sys.exit(f"status {status} after {answers} answers")
                answers += 1
        time.sleep(0.5)
    sys.stdout.write(f"{answers} requests were answered, the slowest after {longest_s:.1f} s\n")


def crowd(url: str) -> None:
    """Be many clients and slow ones: others are answered meanwhile, and the proxy or the API ends the slow ones."""
    with contextlib.ExitStack() as stack:
        silent = [stack.enter_context(opened(url)) for _ in range(NUM_IDLE)]
        trickling = stack.enter_context(opened(url))
        host = urlsplit(url).netloc
        key = f"Authorization: Bearer {os.environ['KEY']}\r\n" if os.environ.get("KEY") else ""
        head = f"POST /v1/sessions HTTP/1.1\r\nHost: {host}\r\n{key}Content-Length: 1000000\r\n"
        head += "Content-Type: multipart/form-data; boundary=x\r\n\r\n--x\r\n"
        head += 'Content-Disposition: form-data; name="videos"; filename="a.mp4"\r\n\r\n'
        trickling.sendall(head.encode() + bytes(2**17))
        with connect(url) as client:
            start_s = time.monotonic()
            client.http.get("/healthz").raise_for_status()
            answered_s = time.monotonic() - start_s
        endless = stack.enter_context(opened(url))
        with contextlib.suppress(ConnectionError, ssl.SSLError):
            endless.sendall(f"GET /healthz HTTP/1.1\r\nHost: {host}\r\nX-Endless: ".encode())
            for _ in range(1000):
                endless.sendall(b"x" * 2**14)
            sys.exit("headers have no end")
        for connection in (silent[0], silent[-1]):
            connection.settimeout(SILENT_S)
            with contextlib.suppress(ConnectionError):
                if connection.recv(1):
                    sys.exit("a client without a request was answered")
        trickling.settimeout(1.0)
        end_s = time.monotonic() + TRICKLING_S
        with contextlib.suppress(ConnectionError, ssl.SSLError):  # the proxy may close it without the API's answer
            while time.monotonic() < end_s:
                with contextlib.suppress(TimeoutError):
                    if (answer := trickling.recv(4096)) and not answer.startswith(b"HTTP/1.1 408 "):
                        sys.exit(f"a body that trickles was answered by {answer!r}")
                    break
                trickling.sendall(b"x")
            else:
                sys.exit("a body may trickle")
    sys.stdout.write(f"beside {NUM_IDLE} idle connections a request took {answered_s:.1f} s; slow clients were ended\n")


def opened(url: str) -> socket.socket:
    """Connection to the proxy."""
    parts = urlsplit(url)
    host = parts.hostname or "localhost"
    address = host, parts.port or (443 if parts.scheme == "https" else 80)
    connection = socket.create_connection(address, timeout=30)
    if parts.scheme == "https":
        return ssl.create_default_context().wrap_socket(connection, server_hostname=host)
    return connection


COMMANDS: Mapping[str, Callable[..., None]] = {
    "begin": begin,
    "continue": continue_upload,
    "send": send,
    "finish": finish,
    "watch": watch,
    "crowd": crowd,
}

if __name__ == "__main__":
    COMMANDS[sys.argv[1]](*sys.argv[2:])
