"""A running service from outside, as our own commands use it: start one, send a session, follow the job, download."""

import contextlib
import hashlib
import json
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2

from api.commands.serve import READY
from pipeline.child_processes import module_command
from pipeline.errors import PipelineError
from worker.lifeline import tied

Json = Mapping[str, Any]

_POLL_S = 0.25
_STOP_S = 30.0
_FINISHED = frozenset({"succeeded", "failed", "canceled", "expired"})


class ServiceError(PipelineError):
    """The service refused, failed or did not start; the text says why."""

    code = "service_error"


@dataclass(frozen=True, slots=True)
class Client:
    """Calls of a service at an address."""

    http: httpx2.Client

    @property
    def url(self) -> str:
        """Where the service is."""
        return str(self.http.base_url)

    def submit(self, name: str, videos: Sequence[Path], calibration: Path) -> Json:
        """Send a session and have it reconstructed; returns the job."""
        manifest = ("manifest", (None, json.dumps({"name": name}), "application/json"))
        with contextlib.ExitStack() as opened:
            parts = [("videos", path) for path in videos] + [("calibration", calibration)]
            files = [(part, (path.name, opened.enter_context(path.open("rb")))) for part, path in parts]
            return self._call("POST", "/v1/jobs", files=[manifest, *files])

    def submit_keypoints(
        self, archives: Mapping[str, bytes], calibration: bytes, timestamps: bytes, spec: Mapping[str, Any]
    ) -> Json:
        """Likewise a zip a camera of OpenPose's files, by the cameras' names, and a calibration in our own format."""
        one_each = [("calibration", "calibration.json", calibration), ("timestamps", "timestamps.csv", timestamps)]
        zips = [("keypoints", f"{camera}.zip", content) for camera, content in archives.items()]
        files = [(part, (name, content)) for part, name, content in (*zips, *one_each)]
        return self._call("POST", "/v1/jobs", files=[*files, ("spec", (None, json.dumps(spec)))])

    def get(self, path: str) -> Json:
        """Read anything."""
        return self._call("GET", path)

    def cancel(self, job: Json) -> None:
        """Cancel a job."""
        self._call("POST", job["links"]["cancel"])

    def delete_session(self, job: Json) -> None:
        """Delete a job's session."""
        self._call("DELETE", job["links"]["session"])

    def follow(self, job: Json, on_job: Callable[[Json], None] = lambda _: None) -> Json:
        """Poll a job until it ends; ``on_job`` is called with every answer.

        Raises
        ------
        ServiceError
            If it does not succeed.
        """
        while job["state"] not in _FINISHED:
            time.sleep(_POLL_S)
            job = self.get(job["links"]["self"])
            on_job(job)
        if job["state"] != "succeeded":
            raise ServiceError(f"The job {job['state']}. {_words(job['error'] or {})}".strip())
        return job

    def download(self, job: Json, folder: Path) -> list[Path]:
        """Save all result files of a job into a folder, which is made if it is missing.

        Raises
        ------
        ServiceError
            A file is damaged, or its download broke off.
        """
        folder.mkdir(parents=True, exist_ok=True)
        return [self._save(result, folder) for result in self._call("GET", job["links"]["results"])["results"]]

    def _save(self, result: Json, folder: Path) -> Path:
        path = folder / result["name"]
        part = folder / f".{result['name']}.part"
        digest = hashlib.sha256()
        try:
            with self.http.stream("GET", result["link"], follow_redirects=True) as answer, part.open("wb") as file:
                if answer.is_error:
                    answer.read()
                    raise _refusal(answer)
                for block in answer.iter_bytes():
                    digest.update(block)
                    file.write(block)
            if digest.hexdigest() != result["sha256"]:
                raise ServiceError(f"The downloaded file {path.name} is damaged: its SHA-256 is not the result's.")
            return part.replace(path)
        except httpx2.TransportError as error:
            raise ServiceError(f"The download of {path.name} broke off. Try again.") from error
        finally:
            part.unlink(missing_ok=True)

    def _call(self, method: str, path: str, **options: Any) -> Json:
        try:
            answer = self.http.request(method, path, **options)
        except httpx2.TransportError as error:
            raise ServiceError(f"The service at {self.url} does not answer.") from error
        if answer.is_error:
            raise _refusal(answer)
        return dict(answer.json()) if answer.content else {}


def _refusal(answer: httpx2.Response) -> ServiceError:
    return ServiceError(_words(answer.json()))


def _words(problem: Json) -> str:
    """A problem, or a job's error, as sentences."""
    items = [": ".join(filter(None, [item["file"], item["message"]])) for item in problem.get("errors", ())]
    return " ".join(filter(None, [problem.get("detail"), *items, problem.get("hint")]))


@contextlib.contextmanager
def served(data_dir: Path, workers: int) -> Iterator[Client]:
    """A service of our own on a free port, for the time of the block.

    Raises
    ------
    ServiceError
        If it does not start.
    """
    data_dir.mkdir(parents=True, exist_ok=True)
    command = module_command("api.cli", "serve", "--port", "0")
    log = data_dir / "serve.log"
    with (
        log.open("wb") as output,
        subprocess.Popen(  # noqa: S603 - the command is ours
            tied([*command, "--data", str(data_dir), "--workers", str(workers)]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=output,
            text=True,
            start_new_session=True,  # Ctrl-C reaches us alone, and we stop it
        ) as process,
    ):
        try:
            line = process.stdout.readline() if process.stdout else ""
            if not line.startswith(READY):
                raise ServiceError(f"The service did not start. {log.read_text(encoding='utf-8').strip()}")
            url = line.removeprefix(READY).strip()
            with httpx2.Client(base_url=url, timeout=300.0, trust_env=False) as http:
                yield Client(http)
        finally:
            process.terminate()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
