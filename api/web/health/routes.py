"""Routes of health: liveness, readiness, and metrics for Prometheus."""

import importlib.metadata
from collections import Counter
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import Field
from sqlalchemy.exc import SQLAlchemyError

from api.web.auth import AdminDep
from api.web.contract.description import Resource, problems
from api.web.contract.schemas import ResponseModel
from api.web.dependencies import ServicesDep
from api.web.errors import ErrorItem, database_damaged, problem_response, service_unavailable
from api.web.metrics import RequestMetrics
from pipeline.core.options.providers import ProviderName
from pipeline.core.options.rules import install_command
from pipeline.core.problems import request_codes
from worker.store.files.disk import DiskSpace
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.repositories.work.workers import shared_by_ready
from worker.store.spec import JobSpec
from worker.store.store import JobStore


class Health(ResponseModel):
    """Liveness of the API process."""

    status: str = "ok"
    version: str = Field(description="Version of Multicap, as `multicap --version` prints it.", examples=["1.0.0"])


class ProviderOut(ResponseModel):
    """Execution provider of the networks of some worker processes."""

    name: ProviderName = Field(description="Name, such as `cuda`.", examples=["cuda"])
    device: str = Field(description="Name of its device; empty if it tells none.", examples=["NVIDIA GeForce RTX 4090"])
    note: str = Field(description="Why it is not the one that was asked for; empty if it is.", examples=[""])
    workers: int = Field(description="Number of ready worker processes with it.")


class Readiness(ResponseModel):
    """Readiness of the service: a worker could start a job now."""

    status: str = "ready"
    checks: dict[str, bool] = Field(
        description="Passed checks by name.", examples=[{"database": True, "broker": True, "worker": True}]
    )
    providers: tuple[ProviderOut, ...] = Field(description="Execution providers of the ready worker processes.")
    disk_free_bytes: int = Field(description="Free bytes on the disk of the data folder.", examples=[214_748_364_800])


router = APIRouter(tags=["health"])

_FIGURES: dict[str, Any] = {
    "text/plain": {"schema": {"type": "string"}, "example": 'multicap_jobs{state="succeeded"} 17.0\n'}
}
_UNAVAILABLE = {
    "database": (request_codes.DATABASE_UNAVAILABLE, "The database does not respond."),
    "broker": (request_codes.BROKER_UNAVAILABLE, "The broker does not respond."),
    "artifacts": (request_codes.ARTIFACTS_UNAVAILABLE, "The artifact store can't be used."),
    "disk": (request_codes.DISK_UNAVAILABLE, "The disk of the data folder does not respond."),
}


@router.get("/healthz", summary="Check that the service is alive")
def get_health() -> Health:
    """Answer while the API process is alive."""
    return Health(version=importlib.metadata.version("multicap"))


@router.get("/readyz", summary="Check that the service is ready", response_model=Readiness)
def get_readiness(request: Request, services: ServicesDep) -> Readiness | Response:
    """Check whether a worker could start a job now. If not, `errors` lists what is missing or starting."""
    results = services.readiness.run(
        {
            "database": lambda: {"database": _database_check(services.store), **_worker_checks(services.store)},
            "broker": lambda: {"broker": _check("broker", services.queue.ping())},
            "artifacts": lambda: {"artifacts": _check("artifacts", services.artifacts.ping())},
            "disk": lambda: {"disk": _disk_check(services.disk)},
        }
    )
    checks: dict[str, ErrorItem | None] = {}
    for name, items in results.items():
        checks |= {name: _SILENT[name]} if items is None else items
    if errors := [item for item in checks.values() if item is not None]:
        # Not raised, because the handler would log it: clients that wait for the service ask every few seconds.
        problem = service_unavailable(request_codes.NOT_READY, "The service can't start a job now.", errors)
        return problem_response(request, problem)
    providers = services.readiness.run({"providers": lambda: _providers(services.store.workers.all())})
    return Readiness(
        checks=dict.fromkeys(checks, True),
        providers=providers["providers"] or (),
        disk_free_bytes=services.disk.free_bytes,
    )


@router.get(
    "/metrics",
    summary="Read the metrics",
    response_class=Response,
    responses={200: {"description": "Metrics for Prometheus.", "content": _FIGURES}, **problems(401, 429)},
)
def get_metrics(_: AdminDep, request: Request, services: ServicesDep) -> Response:
    """Read counts of requests, jobs and chunks in Prometheus' text format. Needs the scope `admin`."""
    metrics: RequestMetrics = request.app.state.metrics
    return Response(metrics.expose(services.store, services.disk), media_type=CONTENT_TYPE_LATEST)


def _providers(workers: Sequence[WorkerStatus]) -> tuple[ProviderOut, ...]:
    """Execution providers of ready workers, the most frequent first."""
    counts = Counter(worker.provider for worker in workers if worker.state is WorkerState.READY)
    return tuple(
        ProviderOut(name=provider.name, device=provider.device, note=provider.note, workers=number)
        for provider, number in counts.most_common()
    )


def _check(name: str, responds: bool) -> ErrorItem | None:
    code, message = _UNAVAILABLE[name]
    return None if responds else ErrorItem(code=code, message=message)


# Parts that have not answered in time.
_SILENT = {name: _check(name, responds=False) for name in _UNAVAILABLE}


def _database_check(store: JobStore) -> ErrorItem | None:
    item = _check("database", store.ping())
    if not store.is_damaged:
        return item
    problem = database_damaged()
    return ErrorItem(code=problem.code, message=problem.detail, hint=problem.hint)


def _disk_check(disk: DiskSpace) -> ErrorItem | None:
    if disk.has_room():
        return None
    left, headroom = disk.free_bytes // 2**20, disk.headroom_bytes // 2**20
    reason = f"{left} MiB left; {headroom} MiB are kept free" if disk.has_inodes else "no inodes left for new files"
    message, hint = f"The disk has {reason}, so nothing new is accepted.", "Delete captures that are no longer needed."
    return ErrorItem(code=request_codes.STORAGE_FULL, message=message, hint=hint)


def _worker_checks(store: JobStore) -> dict[str, ErrorItem | None]:
    """Check that a worker is ready and has the default networks; empty if the database does not respond."""
    try:
        workers = store.workers.all()
    except SQLAlchemyError:
        return {}
    installed = shared_by_ready(workers, "detectors")
    if installed is None:
        return {"worker": _no_worker_ready(workers)}
    missing = [name for name in JobSpec().config.networks.names if name not in installed]
    if not missing:
        return {"worker": None, "model": None}
    item = ErrorItem(
        code=request_codes.MODEL_UNAVAILABLE,
        message=f"Not every worker has the networks of the default profile: {', '.join(missing)}.",
        hint=install_command(*missing),
    )
    return {"worker": None, "model": item}


def _no_worker_ready(workers: Sequence[WorkerStatus]) -> ErrorItem:
    if not workers:
        hint = "Start a worker, and see its log."
        return ErrorItem(code=request_codes.WORKER_UNAVAILABLE, message="There is no worker.", hint=hint)
    furthest = max(workers, key=lambda worker: worker.done)
    if furthest.total == 0:
        return ErrorItem(code=request_codes.WORKER_STARTING, message=f"{furthest.activity}.")
    message = f"{furthest.activity}: {furthest.done} of {furthest.total} steps. A first start takes some minutes."
    return ErrorItem(code=request_codes.WORKER_STARTING, message=message)


RESOURCE = Resource(router=router, is_open=True)
