"""Dependencies of routes: the parts of the service, and ids from paths."""

import uuid
from dataclasses import dataclass, fields
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request

from api.web.events.changes import JobChanges
from api.web.health.checks import LimitedChecks
from api.web.http.bodies.form import FormLimits
from api.web.http.fair_share import FairShare, FairThreads
from api.web.http.keys_in_use import KeysInUse
from api.web.http.rates import Rates
from api.web.live.forks import ForkServer
from api.web.live.places import LivePlaces
from api.web.recordings.rooms import Rooms
from api.web.sessions.preflight import PreflightProgram
from api.web.settings import Settings
from api.web.uploads.spool import UploadSpool
from worker.store.database.quotas import Quotas
from worker.store.errors import NotFound
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.disk import DiskSpace
from worker.store.queue import WorkQueue
from worker.store.store import JobStore

POLL_AFTER_S = 1
"""Time after which a client asks for a new job again."""

_UUID = {"format": "uuid"}


@dataclass(frozen=True, slots=True)
class Services:
    """Parts of the service, put together by ``api.web.app.create_app``."""

    settings: Settings
    store: JobStore
    artifacts: ArtifactStore
    disk: DiskSpace
    uploads: UploadSpool
    queue: WorkQueue
    preflight: PreflightProgram
    turns: FairShare
    checks: FairThreads
    blocks: FairThreads
    changes: JobChanges
    keys_in_use: KeysInUse
    rates: Rates
    wrong_keys: Rates
    readiness: LimitedChecks
    live_places: LivePlaces
    live_forks: ForkServer
    rooms: Rooms

    @property
    def quotas(self) -> Quotas:
        """Quotas of each tenant."""
        return Quotas(
            sessions=self.settings.max_tenant_sessions,
            unfinished_jobs=self.settings.max_tenant_unfinished_jobs,
            stored_bytes=self.settings.max_tenant_bytes,
            uploads=self.settings.max_tenant_uploads,
        )

    @property
    def limits(self) -> FormLimits:
        """Limits of the files of a session."""
        return FormLimits(**{limit.name: getattr(self.settings, limit.name) for limit in fields(FormLimits)})


def app_services(request: Request) -> Services:
    """Parts of the service, from the app."""
    services: Services = request.app.state.services
    return services


# Dependencies that do not wait are ``async``: others take a thread.
async def _services(request: Request) -> Services:
    return app_services(request)


def canonical_id(value: str, kind: str) -> str:
    """Id in lower case; a malformed id is treated as unknown."""
    try:
        return str(uuid.UUID(value))
    except ValueError:
        raise NotFound(f"There is no such {kind}.") from None


def _path_id(kind: str, article: str = "a") -> Any:
    """Dependency on the id of a kind of record in the path."""
    described = Path(alias=f"{kind}_id", description=f"Id of {article} {kind}.", json_schema_extra=_UUID)

    async def path_id(value: Annotated[str, described]) -> str:
        return canonical_id(value, kind)

    return Depends(path_id)


ServicesDep = Annotated[Services, Depends(_services)]
SessionId = Annotated[str, _path_id("session")]
CalibrationId = Annotated[str, _path_id("calibration")]
CharacterId = Annotated[str, _path_id("character")]
RecordingId = Annotated[str, _path_id("recording")]
JobId = Annotated[str, _path_id("job")]
UploadId = Annotated[str, _path_id("upload", "an")]
Limit = Annotated[int, Query(ge=1, le=200, description="How many at most.")]
Cursor = Annotated[uuid.UUID | None, Query(description="`next_cursor` of the page before.")]
