"""Route of options: the choices of a job, and the installed detectors."""

from fastapi import APIRouter, Response

from api.auth import RecordsDep
from api.contract.description import answer
from api.dependencies import ServicesDep
from api.http.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from api.schemas import ChoiceOut, DetectorOut, Options
from pipeline.config import CHOICES, NETWORKS, install_command
from worker.jobs.repositories.work.workers import installed_detectors

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.get(
    "/options",
    operation_id="getOptions",
    summary="Read the choices of a job",
    response_model=Options,
    responses={200: answer("Options") | {"headers": ETAG}, **NOT_MODIFIED},
)
def get_options(services: ServicesDep, _: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """List the choices of a job with their values, limits and defaults, and the detectors that are installed."""
    installed = installed_detectors(services.store.workers.all())
    options = Options(
        detectors=tuple(
            DetectorOut(
                name=name,
                installed=None if installed is None else name in installed,
                install=install_command(name),
            )
            for name in NETWORKS
        ),
        choices=tuple(ChoiceOut.of(choice) for choice in CHOICES.values()),
    )
    return conditional(options, if_none_match)
