"""The web application: routes, middleware, error handlers, and the services that they share."""

import asyncio
import contextlib
import shutil
from collections.abc import AsyncIterator

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import GZipMiddleware

from api.web import errors, page
from api.web.contract import description as contract
from api.web.dependencies import Services
from api.web.events.changes import JobChanges
from api.web.health.checks import LimitedChecks
from api.web.help import HelpFiles
from api.web.http import middleware
from api.web.http.bodies import validation
from api.web.http.fair_share import share_of_requests, threads_of_blocks, threads_of_checks
from api.web.http.keys_in_use import KeysInUse, RevokedKeyGuard
from api.web.http.rates import RATE_HEADERS, request_rates, wrong_key_rates
from api.web.http.websockets import WebSocketGuard
from api.web.jobs.routes import declare_webhooks
from api.web.live.forks import ForkServer
from api.web.live.places import LivePlaces
from api.web.metrics import RequestMetrics
from api.web.recordings.broadcast import RecordingRelay
from api.web.recordings.rooms import Rooms
from api.web.resources import RESOURCES
from api.web.sessions.preflight import PreflightProgram
from api.web.settings import Settings
from api.web.startup import require_keys_if_exposed
from api.web.uploads.fetching import fetch_forever
from api.web.uploads.files import FolderUploads
from api.web.uploads.routes import VERSION as TUS_VERSION
from api.web.uploads.spool import UploadSpool, sweep_forever
from pipeline.run.engine.code import stage_codes
from worker.store.backup.linked import release_abandoned
from worker.store.files.artifacts import open_artifacts
from worker.store.files.disk import DiskSpace, make_private
from worker.store.queue import WorkQueue
from worker.store.store import JobStore

_EXPOSED_HEADERS = [
    *("Content-Disposition", "Content-Range", "ETag", "Idempotent-Replayed", "Location", "Retry-After", "X-Request-ID"),
    *RATE_HEADERS,
    *("Tus-Checksum-Algorithm", "Tus-Extension", "Tus-Max-Size", "Tus-Resumable", "Tus-Version"),
    *("Upload-Expires", "Upload-Length", "Upload-Metadata", "Upload-Offset"),
]
_READINESS_LIMIT_S = 5.0
_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


def create_app(settings: Settings) -> FastAPI:
    """Create the application; the only place where its parts are chosen.

    Files, database and broker are opened when the application starts, not here.
    """
    app = FastAPI(
        title="Multicap",
        version="1",
        description="Markerless motion capture of several people from calibrated cameras.",
        lifespan=_lifespan,
        generate_unique_id_function=contract.operation_id,
        docs_url=None,
        redoc_url=None,
        openapi_url=None,  # answered by `routes.page`: encoded once
        responses=contract.problems(403, 500, 503),
    )
    app.state.settings = settings
    app.state.metrics = RequestMetrics()
    app.openapi = lambda: contract.describe(app, RESOURCES)  # type: ignore[method-assign]
    for resource in RESOURCES:
        app.include_router(resource.router, responses={} if resource.is_open else contract.problems(401, 429))
    app.include_router(page.router)
    app.mount("/portal", GZipMiddleware(page.PortalFiles(), minimum_size=1024))
    app.mount("/help", GZipMiddleware(HelpFiles(), minimum_size=1024))
    declare_webhooks(app)
    errors.install(app)
    validation.install(app)
    app.add_middleware(middleware.FailureResponse)
    app.add_middleware(RevokedKeyGuard)
    app.add_middleware(middleware.HeadByGet)
    # Rules for pages of other origins: browsers may never send a cookie for them.
    app.add_middleware(
        CORSMiddleware,
        allow_origins=sorted(settings.allowed_origins),
        allow_methods=["*"],
        allow_headers=["*"],
        expose_headers=_EXPOSED_HEADERS,
    )
    allowed_hosts = _LOOPBACK_NAMES | settings.allowed_hosts | {settings.host}
    app.add_middleware(
        middleware.ForeignPageGuard, allowed_hosts=allowed_hosts, allowed_origins=settings.allowed_origins
    )
    app.add_middleware(WebSocketGuard, guard=middleware.ForeignPageGuard(app, allowed_hosts, settings.allowed_origins))
    app.add_middleware(middleware.TusProtocol, prefix="/v1/uploads", version=TUS_VERSION)
    app.add_middleware(
        middleware.SlowClientGuard, idle_s=settings.client_idle_s, min_bytes_per_s=settings.client_min_bytes_per_s
    )
    app.add_middleware(middleware.RequestContext, metrics=app.state.metrics)
    return app


@contextlib.asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    services = await run_in_threadpool(_start, app.state.settings)
    app.state.services = services
    tasks = [
        asyncio.create_task(services.changes.poll()),
        asyncio.create_task(services.keys_in_use.poll()),
        asyncio.create_task(services.rooms.run()),
        asyncio.create_task(fetch_forever(services)),
        asyncio.create_task(sweep_forever(services.uploads, services.disk, services.store)),
    ]
    yield
    for task in tasks:
        task.cancel()
    services.live_forks.close()
    services.queue.close()
    services.store.close()


def _open_uploads(settings: Settings, disk: DiskSpace) -> UploadSpool:
    if not settings.shared_uploads:
        return FolderUploads(settings.uploads_dir, disk)
    # The library of S3 is loaded only where it is needed.
    from api.web.uploads.objects import SharedUploads  # noqa: PLC0415

    return SharedUploads(settings.artifacts_url, settings.spool_dir / "uploads", disk, settings.upload_keep_s)


def _start(settings: Settings) -> Services:
    stage_codes()  # it takes tenths of a second, which the first request would have to wait for
    # Files that an earlier process was receiving when it was killed. No other process uses the folder.
    shutil.rmtree(settings.spool_dir, ignore_errors=True)
    make_private(settings.data_dir)
    disk = DiskSpace(settings.data_dir, settings.headroom_bytes)
    disk.using_reserve(lambda: settings.spool_dir.mkdir(exist_ok=True))
    store = JobStore(settings.resolved_database_url)
    disk.using_reserve(store.migrate)
    require_keys_if_exposed(settings, store)
    release_abandoned(settings.data_dir)
    uploads = _open_uploads(settings, disk)
    disk.set_aside()
    return Services(
        settings=settings,
        store=store,
        artifacts=open_artifacts(settings.artifacts_url, settings.data_dir),
        disk=disk,
        uploads=uploads,
        queue=WorkQueue(settings.broker_url),
        preflight=PreflightProgram(
            settings.preflight_command,
            settings.preflight_timeout_s,
            settings.max_preflight_bytes,
            settings.max_record_bytes,
            settings.preflight_memory_bytes,
            settings.character_command,
            settings.calibration_command,
        ),
        turns=share_of_requests(),
        checks=threads_of_checks(settings.max_parallel_preflights, settings.preflight_wait_s),
        blocks=threads_of_blocks(),
        changes=JobChanges(store, settings.max_tenant_streams),
        keys_in_use=KeysInUse(store),
        rates=request_rates(settings.max_requests_per_minute),
        wrong_keys=wrong_key_rates(settings.max_wrong_keys_per_minute),
        readiness=LimitedChecks(_READINESS_LIMIT_S),
        live_places=LivePlaces(
            settings.max_live_captures,
            settings.max_tenant_live_captures,
            settings.max_bad_live_captures_per_minute,
            settings.max_live_camera_captures,
        ),
        live_forks=ForkServer(settings.live_command),
        rooms=Rooms(store, RecordingRelay(settings.broker_url)),
    )
