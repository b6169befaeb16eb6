"""Campaign of hostile sessions against a running service; observes memory and the jobs of another tenant."""

import json
import queue
import statistics
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import httpx2
import psutil

from tests.e2e.serving import Served
from tests.waiting import is_alive

MIB = 2**20

MAX_REQUEST_S = 30.0
MAX_SILENCE_S = 60.0
MAX_DELAY_S = 10.0
MAX_API_BYTES = 512 * MIB
MAX_WORKER_BYTES = 2048 * MIB

ACCEPTED = frozenset({201, 202})
REFUSED = frozenset({400, 413, 415, 422})
_FINISHED = frozenset({"succeeded", "failed", "canceled"})
# Errors of jobs that Multicap causes, not the input.
_OUR_FAULT = frozenset({"internal_error", "worker_lost", "timed_out"})
_UNFINISHED_JOBS = 6

# Field of the form, file name (empty: a field that is no file), content.
Part = tuple[str, str, bytes]


@dataclass
class CampaignReport:
    """Observations of a campaign; ``faults`` lists everything that must not happen."""

    faults: list[str] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    job_ends: Counter[str] = field(default_factory=Counter)
    longest_request_s: float = 0.0
    longest_silence_s: float = 0.0
    api_bytes: int = 0
    worker_bytes: int = 0
    undisturbed_s: float = 0.0
    victim_s: list[float] = field(default_factory=list)

    @property
    def longest_delay_s(self) -> float:
        """Longest time that the other tenant's job took beyond its undisturbed time."""
        return max(self.victim_s, default=0.0) - self.undisturbed_s

    def lines(self) -> list[str]:
        """Summary, a line each."""
        return [
            f"requests by status: {dict(sorted(self.statuses.items()))}, longest {self.longest_request_s:.1f} s",
            f"problem codes: {dict(self.codes.most_common())}",
            f"jobs: {dict(self.job_ends.most_common())}, longest without progress {self.longest_silence_s:.1f} s",
            f"peak memory: API {self.api_bytes / MIB:.0f} MiB, workers {self.worker_bytes / MIB:.0f} MiB",
            f"other tenant: {len(self.victim_s)} jobs, undisturbed {self.undisturbed_s:.1f} s, "
            f"median {statistics.median(self.victim_s or [0.0]):.1f} s, longest delay {self.longest_delay_s:.1f} s",
        ]

    def check(self) -> None:
        """Fail if something happened that must not, or memory exceeded its limit."""
        assert not self.faults, "\n".join(self.faults[:20])
        assert 0 < self.api_bytes < MAX_API_BYTES
        assert 0 < self.worker_bytes < MAX_WORKER_BYTES

    def check_times(self) -> None:
        """Fail if a time exceeded its limit; for a machine that does nothing else."""
        assert self.longest_request_s < MAX_REQUEST_S
        assert self.longest_silence_s < MAX_SILENCE_S
        assert self.longest_delay_s < MAX_DELAY_S


class Campaign:
    """Hostile tenant that sends sessions, and another tenant that sends ordinary ones meanwhile.

    Parameters
    ----------
    served
        Running service.
    hostile_key, victim_key
        Keys of two tenants.
    victim_session
        Parts of the other tenant's ordinary session, which makes a short job.
    """

    def __init__(self, served: Served, hostile_key: str, victim_key: str, victim_session: Sequence[Part]) -> None:
        self._served = served
        self._victim_key, self._victim_session = victim_key, victim_session
        self._hostile = self._client(hostile_key)
        self._jobs: queue.Queue[dict[str, Any]] = queue.Queue(_UNFINISHED_JOBS)
        self._ended = threading.Event()
        self.report = CampaignReport()

    def close(self) -> None:
        """Close the hostile tenant's connections."""
        self._hostile.close()

    def send(self, parts: Sequence[Part], spec: Mapping[str, Any] | None = None) -> httpx2.Response:
        """Send a session, and its job with ``spec``; wait as ``Retry-After`` demands."""
        path = "/v1/sessions" if spec is None else "/v1/jobs"
        files: list[Any] = [(name, (file or None, content)) for name, file, content in parts]
        if spec is not None:
            files.append(("spec", (None, json.dumps(spec))))
        while True:
            started_s = time.monotonic()
            try:
                answer = self._hostile.post(path, files=files)
            except httpx2.TransportError as error:
                self.report.faults.append(f"no answer: {error!r}")
                raise
            duration_s = time.monotonic() - started_s
            self.report.longest_request_s = max(self.report.longest_request_s, duration_s)
            self.report.statuses[answer.status_code] += 1
            if answer.status_code != 429:
                break
            time.sleep(float(answer.headers["Retry-After"]))
        if answer.status_code in REFUSED:
            self.report.codes.update({one["code"] for one in answer.json()["errors"]})
        elif answer.status_code == 202:
            self._jobs.put(answer.json() | {"videos": [file for part, file, _ in parts if part == "videos"]})
        elif answer.status_code != 201:
            self.report.faults.append(f"{answer.status_code}: {answer.text[:500]}")
        return answer

    def delete(self, session_id: str) -> None:
        """Delete a session of the hostile tenant."""
        self._hostile.delete(f"/v1/sessions/{session_id}")

    @contextmanager
    def observed(self) -> Iterator[CampaignReport]:
        """Observe jobs, memory and the other tenant during the block, and until the last hostile job has ended."""
        self.report.undisturbed_s = statistics.median(self._victim_job() for _ in range(3))
        with ThreadPoolExecutor(3) as pool:
            observers = [pool.submit(one) for one in (self._follow_jobs, self._measure_memory, self._send_as_victim)]
            try:
                yield self.report
            finally:
                self._ended.set()
        for one in observers:
            one.result()

    def _client(self, key: str) -> httpx2.Client:
        headers = {"Authorization": f"Bearer {key}"}
        return httpx2.Client(base_url=self._served.client.base_url, headers=headers, timeout=120.0, trust_env=False)

    def _follow_jobs(self) -> None:
        """Poll running jobs; record their ends and their longest times without progress."""
        changes: dict[str, tuple[Any, float]] = {}
        running: dict[str, dict[str, Any]] = {}
        while not self._ended.is_set() or running or not self._jobs.empty():
            while not self._jobs.empty():
                job = self._jobs.get()
                running[job["id"]] = job
            for job_id in list(running):
                job = self._hostile.get(f"/v1/jobs/{job_id}").raise_for_status().json()
                seen = (job["state"], job["attempt"], job["progress"], [one["done"] for one in job["stages"]])
                now_s = time.monotonic()
                before, since_s = changes.get(job_id, (None, now_s))
                if seen == before and job["state"] == "running":
                    self.report.longest_silence_s = max(self.report.longest_silence_s, now_s - since_s)
                else:
                    changes[job_id] = seen, now_s
                if job["state"] in _FINISHED:
                    self._note_end(running.pop(job_id) | job)
            time.sleep(0.5)

    def _note_end(self, job: Mapping[str, Any]) -> None:
        code = job["error"]["code"] if job["error"] else ""
        self.report.job_ends[" ".join(filter(None, [job["state"], code]))] += 1
        if code and job["videos"] and not any(name in job["error"]["detail"] for name in job["videos"]):
            self.report.faults.append(f"a job of videos failed without the name of one: {job['error']}")
        if code in _OUR_FAULT or job["state"] == "canceled":
            self.report.faults.append(f"job {job['state']}: {job['error']}")
        self.delete(job["session_id"])

    def _measure_memory(self) -> None:
        """Sample resident memory of the API and of every worker process."""
        while not self._ended.wait(0.2):
            for process in self._served.tree():
                try:
                    words, resident = process.cmdline(), process.memory_info().rss
                except psutil.Error:
                    continue
                if "celery" in words or "worker" in " ".join(words):
                    self.report.worker_bytes = max(self.report.worker_bytes, resident)
                elif any("api" in word for word in words):
                    self.report.api_bytes = max(self.report.api_bytes, resident)

    def _send_as_victim(self) -> None:
        while not self._ended.wait(5.0):
            self.report.victim_s.append(self._victim_job())

    def _victim_job(self) -> float:
        """Send the other tenant's session and wait for its job; return the time."""
        files: list[Any] = [(name, (file, content)) for name, file, content in self._victim_session]
        with self._client(self._victim_key) as client:
            started_s = time.monotonic()
            answer = client.post("/v1/jobs", files=files)
            if answer.status_code != 202:
                self.report.faults.append(f"the other tenant was refused: {answer.status_code} {answer.text[:500]}")
                return 0.0
            job = answer.json()
            while job["state"] not in _FINISHED:
                time.sleep(0.1)
                job = client.get(f"/v1/jobs/{job['id']}").raise_for_status().json()
            duration_s = time.monotonic() - started_s
            if job["state"] != "succeeded":
                self.report.faults.append(f"the other tenant's job {job['state']}: {job['error']}")
            client.delete(f"/v1/sessions/{job['session_id']}").raise_for_status()
        return duration_s


def alive(served: Served) -> bool:
    """Return whether the service's supervisor runs and its API answers."""
    return is_alive(psutil.Process(served.process.pid)) and served.client.get("/healthz").status_code == 200
