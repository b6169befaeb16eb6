"""Whether the service is alive, and whether it can work."""

from typing import Any

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST

from api.auth import AdminDep
from api.contract import answer, problems
from api.dependencies import ServicesDep
from api.errors import ErrorItem, service_away
from api.metrics import RequestMetrics
from api.schemas import Health, Readiness
from api.settings import Settings
from worker.jobs.spec import JobSpec

router = APIRouter(tags=["health"])

_FIGURES: dict[str, Any] = {
    "text/plain": {"schema": {"type": "string"}, "example": 'multicap_jobs{state="succeeded"} 17.0\n'}
}
_MESSAGES = {
    "database": "The database does not answer.",
    "broker": "The broker does not answer.",
    "artifacts": "The artifact store can't be used.",
    "model": "The detector network is not installed.",
}


@router.get("/healthz", operation_id="getHealth", responses={200: answer("Health")})
def get_health() -> Health:
    """Say that the process is alive."""
    return Health()


@router.get("/readyz", operation_id="getReadiness", responses={200: answer("Readiness")})
def get_readiness(services: ServicesDep) -> Readiness:
    """Say whether everything that jobs need is there."""
    checks = {
        "database": services.store.ping(),
        "broker": services.queue.ping(),
        "artifacts": services.artifacts.ping(),
        "model": _model_is_installed(services.settings),
    }
    away = [name for name, there in checks.items() if not there]
    if away:
        errors = [ErrorItem(code=f"{name}_unavailable", message=_MESSAGES[name]) for name in away]
        raise service_away("not_ready", "A part of the service is away.", errors)
    return Readiness(checks=checks)


@router.get(
    "/metrics",
    operation_id="getMetrics",
    response_class=Response,
    responses={200: {"description": "Figures for Prometheus.", "content": _FIGURES}, **problems(401, 429)},
)
def get_metrics(_: AdminDep, request: Request, services: ServicesDep) -> Response:
    """Say how much is asked, done and waiting, in Prometheus' text format. Needs the scope `admin`."""
    metrics: RequestMetrics = request.app.state.metrics
    return Response(metrics.expose(services.store), media_type=CONTENT_TYPE_LATEST)


def _model_is_installed(settings: Settings) -> bool:
    return not settings.readiness_needs_model or (settings.models_dir / f"{JobSpec().detector}.onnx").is_file()
