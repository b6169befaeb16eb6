"""Client of a service: send a session, wait for its job, download the results."""

import base64
import contextlib
import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, BinaryIO, Literal, Self, TypedDict, cast

import httpx2

from pipeline.core.errors import PipelineError
from pipeline.core.paths import StrPath
from pipeline.core.problems.finding_codes import SERVICE_ERROR
from pipeline.core.runtime.pauses import Pauses

Json = Mapping[str, Any]

_POLL_S = 0.25
# Tries of a request that the service does not answer, and the pauses between them: about a minute.
_MAX_TRIES, _FIRST_PAUSE_S, _LONGEST_PAUSE_S = 8, 1.0, 20.0
_ENDS = {"succeeded": "succeeded", "failed": "failed", "canceled": "was canceled", "expired": "expired"}


class ClientStage(TypedDict):
    """Stage of a job."""

    name: str  # Name, such as ``detect`` or ``fit``
    state: str  # State, such as ``running`` or ``done``
    # Number of finished units of work, such as frames, and number of all units
    done: int
    total: int
    # ISO 8601 times; ``None`` before
    started_at: str | None
    finished_at: str | None


class Job(TypedDict):
    """Job as the service describes it. These are the common fields; ``/docs`` of a service has all.

    Attributes
    ----------
    id, session_id
        Ids of the job and of the session that it reconstructs.
    files_state
        Files of a job that has succeeded, after edits: ``current``, ``updating`` or ``failed``; ``None`` of other jobs.
    progress
        Share of the work that is done, from 0 to 1.
    queue_position
        Place in the queue, from 1; ``None`` once the job runs.
    eta_s
        Estimated seconds left; ``None`` before any work is done, and at the end.
    error
        Error of a failed job, with ``code``, ``detail`` and ``hint``; ``None`` for other jobs.
    warnings
        Warnings about the files, the choices and the result, each with ``code``, ``message`` and ``hint``.
    urls
        URLs by name, such as ``self`` and ``results``.

    Examples
    --------
    >>> job: Job = {"id": "01a", "progress": 0.5, "state": "running"}
    >>> f"{job['progress']:.0%}"
    '50%'
    """

    id: str
    session_id: str
    state: Literal["queued", "running", "canceling", "succeeded", "failed", "canceled", "expired"]
    files_state: Literal["current", "updating", "failed"] | None
    stages: list[ClientStage]
    progress: float
    queue_position: int | None
    eta_s: float | None
    error: dict[str, Any] | None
    warnings: list[dict[str, Any]]
    urls: dict[str, Any]


class ServiceError(PipelineError):
    """The service refused a request, failed, did not start or did not respond; the text states the reason.

    Examples
    --------
    >>> str(ServiceError("The service does not respond."))
    'The service does not respond.'
    """

    code = SERVICE_ERROR


class UnavailableError(ServiceError):
    """The service, or a part of it, does not respond now."""


@dataclass(frozen=True, slots=True)
class Client:
    """Client of a service.

    ``Client.connect`` creates a client for an address. Close it after use, or use it in a ``with`` block.

    Parameters
    ----------
    http
        HTTP client with the service's address, the key if the service requires keys, and the timeout of a call.

    Examples
    --------
    >>> with Client.connect("http://127.0.0.1:8000") as client:  # doctest: +SKIP
    ...     job = client.submit("Take 1", [Path("cam01.mp4"), Path("cam02.mp4")], Path("Calib.qca.txt"))
    ...     job = client.follow(job, lambda job: print(f"{job['progress']:.0%}"), timeout_s=3600)
    ...     paths = client.download(job, Path("results"))
    """

    http: httpx2.Client

    @classmethod
    def connect(cls, url: str, key: str | None = None, timeout_s: float = 300.0, *, trust_env: bool = True) -> Self:
        """Create a client of the service at an address; nothing is sent yet.

        Parameters
        ----------
        url
            Address, such as ``http://127.0.0.1:8000``.
        key
            API key, ``mc_...``; ``None`` for a service without keys.
        timeout_s
            Longest time without a byte from the service in a call. The response to an upload comes after the check of
            its files.
        trust_env
            Whether proxies of the environment (``HTTP_PROXY``) are used.

        Raises
        ------
        ServiceError
            If the address is not an HTTP address.
        """
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        try:
            http = httpx2.Client(base_url=url, headers=headers, timeout=timeout_s, trust_env=trust_env)
        except httpx2.InvalidURL as error:
            raise ServiceError(f"{url!r} is not an address: {error}.") from error
        if http.base_url.scheme not in {"http", "https"}:
            raise ServiceError(f"{url!r} is not an address such as http://127.0.0.1:8000.")
        return cls(http)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self.http.close()

    @property
    def url(self) -> str:
        """Address of the service."""
        return str(self.http.base_url)

    def submit(
        self,
        name: str,
        videos: Sequence[StrPath],
        calibration: StrPath,
        spec: Mapping[str, Any] | None = None,
        manifest: Mapping[str, Any] | None = None,
    ) -> Job:
        """Send a session of videos and have it reconstructed.

        Parameters
        ----------
        videos
            One video of each camera, with the camera's name as a word in its own; or as the manifest states. Either
            all files, or all https links that the service fetches the files from; then the job waits for them.
        calibration
            Calibration file of any format that ``open_session`` reads.
        spec
            Choices of the job, such as ``{"method": "clustering", "exports": ["glb"]}``; ``None`` for the defaults.
        manifest
            Facts about the session, such as ``{"cameras": [{"name": "left", "file": "GX010042.MP4", "rate": 240.0}]}``.

        Returns
        -------
            Queued or running job.

        Raises
        ------
        ServiceError
            If the service refuses the files, with all problems of all files, or does not respond.
        OSError
            If a file can't be read.
        """
        texts = _texts(name, spec, manifest)
        if any(str(video).startswith(("https://", "http://")) for video in videos):
            return self._submit_links([*map(str, videos)], Path(calibration), texts)
        return self._submit_files([*(("videos", path) for path in videos), ("calibration", calibration)], texts)

    def submit_points(
        self,
        name: str,
        files: Sequence[StrPath],
        spec: Mapping[str, Any] | None = None,
        manifest: Mapping[str, Any] | None = None,
    ) -> Job:
        """Send 3D points that another system has located, and have skeletons solved.

        Parameters
        ----------
        files
            TRC, C3D, BVH, CSV, NetCDF, NPY or 3D JSON, of people at one time; or a zip of a JSON file a frame.
        spec, manifest
            See ``submit``. The manifest may have ``frame_rate_hz``, ``units``, ``up`` and ``names``.

        Returns
        -------
            Queued or running job.

        Raises
        ------
        ServiceError, OSError
            See ``submit``.
        """
        return self._submit_files([("points", path) for path in files], _texts(name, spec, manifest))

    def _submit_files(self, parts: Sequence[tuple[str, StrPath]], texts: Mapping[str, Json]) -> Job:
        described = [(part, (None, json.dumps(text), "application/json")) for part, text in texts.items()]
        with contextlib.ExitStack() as opened:
            paths = [(part, Path(path)) for part, path in parts]
            files = [(part, (path.name, opened.enter_context(path.open("rb")))) for part, path in paths]
            return _job(self._call("POST", "/v1/jobs", files=[*described, *files]))

    def _submit_links(self, urls: Sequence[str], calibration: Path, texts: Mapping[str, Json]) -> Job:
        """Send a session whose videos the service fetches."""
        content, name = calibration.read_bytes(), base64.b64encode(calibration.name.encode()).decode()
        headers = {
            "Tus-Resumable": "1.0.0",
            "Upload-Length": str(len(content)),
            "Upload-Metadata": f"filename {name}",
            "Content-Type": "application/offset+octet-stream",
        }
        place = self._sent("POST", "/v1/uploads", headers=headers, content=content).headers["location"]
        body = {**texts, "videos": urls, "calibration": place.rpartition("/")[2]}
        return _job(self._call("POST", "/v1/jobs/from-uploads", json=body))

    def submit_keypoints(
        self, archives: Mapping[str, bytes], calibration: bytes, timestamps: bytes, spec: Mapping[str, Any]
    ) -> Job:
        """Send a session of 2D joints and have it reconstructed.

        Parameters
        ----------
        archives
            Zip of each camera's keypoint files, by camera name.
        calibration
            Calibration in Multicap's own format, JSON.
        timestamps
            Timestamps as CSV with the columns camera, frame, time_s.
        """
        shared = [("calibration", "calibration.json", calibration), ("timestamps", "timestamps.csv", timestamps)]
        zips = [("keypoints", f"{camera}.zip", content) for camera, content in archives.items()]
        files = [(part, (name, content)) for part, name, content in (*zips, *shared)]
        return _job(self._call("POST", "/v1/jobs", files=[*files, ("spec", (None, json.dumps(spec)))]))

    def get(self, path: str) -> Json:
        """Read a path of the service, such as ``job["urls"]["self"]``."""
        return self._call("GET", path)

    def cancel(self, job: Json) -> None:
        """Cancel a job."""
        self._call("POST", job["urls"]["cancel"])

    def delete_session(self, job: Json) -> None:
        """Delete a job's session."""
        self._call("DELETE", job["urls"]["session"])

    def edit(self, job: Json, edits: Sequence[Mapping[str, Any]]) -> Json:
        """Replace the edits of a job's session, and have the job's files made again; ``follow`` waits for them.

        Parameters
        ----------
        edits
            All edits in their order, such as ``{"action": "rename", "person": 1, "name": "Anna"}``. Numbers of people
            are the job's.

        Returns
        -------
            The edits with places for numbers, and the people of the job's run after them.
        """
        body = {"edits": list(edits), "job_id": job["id"]}
        return self._call("PUT", f"{job['urls']['session']}/edits", json=body)

    def add_files(self, job: Json, **files: Any) -> Job:
        """Add files to a job that has succeeded, without reconstructing again.

        Parameters
        ----------
        files
            Files by the names of a job's choices, such as ``exports=["glb"], preset="unreal", report=True``.

        Returns
        -------
            The job, whose files ``follow`` waits for.
        """
        return _job(self._call("POST", job["urls"]["files"], json=files))

    def follow(self, job: Json, on_job: Callable[[Job], None] = lambda _: None, timeout_s: float | None = None) -> Job:
        """Wait until a job succeeds, after an edit until its files are current.

        Parameters
        ----------
        on_job
            Called four times a second with the current job: ``progress``, ``eta_s``, ``stages``.
        timeout_s
            Longest waiting time; ``None``: until the job ends. The job continues after a timeout.

        Raises
        ------
        ServiceError
            If the job or the update of its files fails, is canceled, or does not end in time, or the service does not
            respond for a minute.
        """
        deadline_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        now = _job(job)
        while now["state"] not in _ENDS or now["files_state"] == "updating":
            if time.monotonic() >= deadline_s:
                doing = "updating its files" if now["files_state"] == "updating" else now["state"]
                raise ServiceError(
                    f"The job {now['id']} did not end within {timeout_s:g} s; it is {doing} and continues."
                )
            time.sleep(_POLL_S)
            now = _job(self._get_patiently(now["urls"]["self"]))
            on_job(now)
        if now["state"] != "succeeded" or now["files_state"] == "failed":
            what = "files were not made again" if now["files_state"] == "failed" else f"job {_ENDS[now['state']]}"
            raise ServiceError(f"The {what}. {_sentences(now['error'] or {})}".strip())
        return now

    def download(self, job: Json, folder: StrPath) -> list[Path]:
        """Download all result files of a job to a folder, which is created if it is missing.

        Raises
        ------
        ServiceError
            If a file is damaged, or its download breaks off again and again; else it continues where it broke.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        return [self._save(result, folder) for result in self._get_patiently(job["urls"]["results"])["results"]]

    def _save(self, result: Json, folder: Path) -> Path:
        path = folder / result["name"]
        part = folder / f".{result['name']}.part"
        pauses = Pauses(_FIRST_PAUSE_S, _LONGEST_PAUSE_S)
        num_tries = 0
        try:
            with part.open("w+b") as file:
                while not self._received(result, file):
                    num_tries += 1
                    if num_tries == _MAX_TRIES:
                        raise ServiceError(f"The download of {path.name} broke off. Try again.")
                    time.sleep(pauses.next_s())
                file.seek(0)
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            if sha256 != result["sha256"]:
                raise ServiceError(f"The downloaded file {path.name} is damaged: its SHA-256 is not the result's.")
            return part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    def _received(self, result: Json, file: BinaryIO) -> bool:
        """Receive the rest of a result file; ``False`` if the connection breaks, or the service asks to wait."""
        start = file.tell()
        headers = {"Range": f"bytes={start}-", "If-Range": f'"{result["sha256"]}"'} if start else {}
        try:
            with self.http.stream("GET", result["url"], headers=headers, follow_redirects=True) as answer:
                if answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE:
                    return False
                if answer.is_error:
                    answer.read()
                    raise _refusal(answer)
                if answer.status_code != HTTPStatus.PARTIAL_CONTENT:  # it begins again
                    file.seek(0)
                    file.truncate()
                for block in answer.iter_bytes():
                    file.write(block)
        except httpx2.TransportError:
            return False
        return True

    def _get_patiently(self, path: str) -> Json:
        """Read a path; try again for about a minute while the service does not respond."""
        pauses = Pauses(_FIRST_PAUSE_S, _LONGEST_PAUSE_S)
        for _ in range(_MAX_TRIES - 1):
            with contextlib.suppress(UnavailableError):
                return self.get(path)
            time.sleep(pauses.next_s())
        return self.get(path)

    def _sent(self, method: str, path: str, **options: Any) -> httpx2.Response:
        try:
            answer = self.http.request(method, path, **options)
        except httpx2.TransportError as error:
            raise UnavailableError(f"The service at {self.url} does not answer.") from error
        if answer.is_error:
            raise _refusal(answer)
        return answer

    def _call(self, method: str, path: str, **options: Any) -> Json:
        answer = self._sent(method, path, **options)
        document = _object(answer) if answer.content else {}
        if document is None:
            raise ServiceError(f"The server at {self.url} is not a Multicap service.")
        return document


def _texts(name: str, spec: Json | None, manifest: Json | None) -> dict[str, Json]:
    """JSON parts of a form."""
    return {"manifest": {"name": name, **(manifest or {})}, **({} if spec is None else {"spec": spec})}


def _job(answer: Json) -> Job:
    return cast("Job", answer)


def _object(answer: httpx2.Response) -> Json | None:
    """JSON object in the body of a response; ``None`` if the body is anything else."""
    try:
        document = answer.json()
    except ValueError:
        return None
    return document if isinstance(document, dict) else None


def _refusal(answer: httpx2.Response) -> ServiceError:
    """Error with the sentences of the service; a proxy may answer without any."""
    problem = _object(answer) or {}
    sentences = _sentences(problem)
    kind = UnavailableError if answer.status_code == HTTPStatus.SERVICE_UNAVAILABLE else ServiceError
    return kind(sentences or f"The service at {answer.url.host} answered {answer.status_code}.")


def _sentences(problem: Json) -> str:
    items = [": ".join(filter(None, [item.get("file"), item["message"]])) for item in problem.get("errors", ())]
    return " ".join(filter(None, [problem.get("detail"), *items, problem.get("hint")]))
