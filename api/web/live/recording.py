"""Calibrations of live cameras: they are recorded for a moment, and the videos are calibrated as others are."""

import json
from dataclasses import replace
from pathlib import Path

from starlette.concurrency import run_in_threadpool

from api.web.calibrations.intake import CALIBRATION_FORM, CheckedCalibration, begun_calibration, check_calibration
from api.web.dependencies import Services
from api.web.http.bodies.field_places import NO_PLACES
from api.web.http.bodies.form import Form, Parts
from api.web.http.bodies.form_kinds import SPEC, VIDEOS
from api.web.live.cameras import record_cameras
from api.web.live.connection import LiveConnection
from api.web.live.schemas import LiveRecorded, LiveRecordStart
from api.web.sessions.manifest import CameraManifest
from api.web.sessions.receiving import Sent
from worker.store.tenant_records import TenantRecords


async def record_calibration(connection: LiveConnection, start: LiveRecordStart, folder: Path) -> LiveRecorded:
    """Record cameras, and begin their calibration; raises ``SocketProblem`` or ``ApiError`` with all that is wrong."""
    services, records, owner = connection.services, connection.records, connection.caller.owner
    await run_in_threadpool(records.require_room, 0)
    videos = await record_cameras(connection, start, folder)
    choices = start.spec(tuple(camera.model_dump(mode="json") for camera in videos), "live")
    spec = json.dumps({name: value for name, value in choices.items() if value not in (None, [])})
    form = await services.checks.run(owner, _form, services, folder, videos)
    sent = Sent(folder, CALIBRATION_FORM, replace(form, documents={SPEC: spec.encode()}), None, NO_PLACES)
    checked = await check_calibration(owner, services, records, sent)
    return await run_in_threadpool(_begin, services, records, checked)


def _form(services: Services, folder: Path, videos: dict[CameraManifest, Path]) -> Form:
    """Form with the videos, as a client would send it."""
    parts = Parts(folder, services.limits, CALIBRATION_FORM, NO_PLACES)
    for camera, path in videos.items():
        parts.adopt(VIDEOS, str(camera.file), path)
    return parts.form((SPEC,))


def _begin(services: Services, records: TenantRecords, checked: CheckedCalibration) -> LiveRecorded:
    with begun_calibration(services, records, checked) as (_, job):
        return LiveRecorded(calibration_id=job.id)
