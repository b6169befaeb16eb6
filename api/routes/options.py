"""Options: what jobs can ask for here."""

from fastapi import APIRouter, Response

from api.auth import RecordsDep
from api.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from api.contract import answer
from api.dependencies import ServicesDep
from api.schemas import DetectorOut, Options
from worker.jobs.spec import INSTALL_COMMANDS
from worker.jobs.workers import installed_detectors

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.get(
    "/options",
    operation_id="getOptions",
    summary="Read what jobs can ask for",
    response_model=Options,
    responses={200: answer("Options") | {"headers": ETAG}, **NOT_MODIFIED},
)
def get_options(services: ServicesDep, _: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """List the detectors, and say which of them are installed."""
    installed = installed_detectors(services.store.workers())
    options = Options(
        detectors=tuple(
            DetectorOut(name=name, installed=None if installed is None else name in installed, install=command)
            for name, command in INSTALL_COMMANDS.items()
        )
    )
    return conditional(options, if_none_match)
