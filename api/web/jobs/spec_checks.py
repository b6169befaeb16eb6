"""Checks of a spec against a session, the workers and the limits of the service."""

from urllib.parse import urlsplit

from api.web.dependencies import Services
from api.web.errors import ErrorItem, pointer_to
from pipeline.capture.preflight_record import Preflight
from pipeline.core.findings import CERTAIN
from pipeline.core.options.config import FILE_FORMATS, INSTALL_BODY, Sync, Timeline, install_command, networks_of
from pipeline.core.options.rules import format_problems, session_problems
from pipeline.core.problems.model import Code
from pipeline.core.problems.requests import FRAMES_TOO_LARGE
from pipeline.core.problems.sessions import SESSION_TOO_LONG
from pipeline.core.problems.specs import (
    BODY_NOT_INSTALLED,
    CALLBACK_INVALID,
    CALLBACK_NOT_HTTPS,
    CALLBACK_NOT_PUBLIC,
    CHARACTER_UNKNOWN,
    DETECTOR_NOT_INSTALLED,
    WEBHOOK_SECRET_MISSING,
)
from worker.run.webhooks.addresses import may_be_public, url_fault
from worker.store.errors import NotFound
from worker.store.repositories.work.workers import installed_bodies, installed_detectors, writable_formats
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


def spec_errors(spec: JobSpec, preflight: Preflight, *field: str) -> list[ErrorItem]:
    """Choices that conflict with a session; ``field`` leads to the spec in the request."""
    problems = session_problems(spec.config, preflight.timebase.num_frames, preflight.timebase.frame_rate_hz)
    return [
        ErrorItem(
            pointer=pointer_to(*field, str(problem.field)),
            code=problem.code,
            message=problem.message,
            hint=problem.hint,
        )
        for problem in problems
    ]


def session_errors(spec: JobSpec, preflight: Preflight) -> list[ErrorItem]:
    """Errors of a session with which nobody could be located; none if the job is forced.

    The other errors are judged with the people, in the job.
    """
    return [
        ErrorItem(code=finding.code, message=finding.message, camera=finding.camera, hint=finding.hint)
        for finding in (() if spec.force else preflight.findings)
        if finding.severity == "error" and finding.code in CERTAIN
    ]


def for_session(spec: JobSpec, sync: Sync, timeline: Timeline) -> JobSpec:
    """Spec with the session's synchronisation and frames of the files, unless the client stated them."""
    of_session = {"sync": sync, "timeline": timeline}
    return spec.model_copy(update={name: of_session[name] for name in of_session.keys() - spec.model_fields_set})


def limit_errors(services: Services, preflight: Preflight) -> list[ErrorItem]:
    """Properties of a session that exceed the limits of the operator."""
    settings, duration_s = services.settings, preflight.duration_s
    found = []
    if settings.max_duration_s is not None and duration_s > settings.max_duration_s:
        message = f"The session lasts {duration_s:.2f} s; at most {settings.max_duration_s:g} s are taken."
        found.append(ErrorItem(code=SESSION_TOO_LONG, message=message, hint="Cut it into several sessions."))
    if settings.max_pixels is not None:
        for camera in preflight.cameras:
            width, height = camera.size_px
            if width * height > settings.max_pixels:
                message = f"Its frames have {width} x {height} pixels; at most {settings.max_pixels} are taken."
                item = ErrorItem(code=FRAMES_TOO_LARGE, message=message, file=camera.file, camera=camera.name)
                found.append(item)
    return found


def callback_errors(spec: JobSpec, services: Services, records: TenantRecords, *field: str) -> list[ErrorItem]:
    """Reasons why webhooks can't be sent to the address of a spec; ``field`` as of ``spec_errors``."""
    if spec.callback_url is None:
        return []
    found: list[tuple[Code, str, str | None]] = []
    if fault := url_fault(spec.callback_url):
        found.append((CALLBACK_INVALID, fault, None))
    elif not services.settings.webhook_private:
        address = urlsplit(spec.callback_url)
        if address.scheme != "https":
            found.append((CALLBACK_NOT_HTTPS, "Webhooks go to https addresses only.", None))
        if not may_be_public(address.hostname or ""):
            found.append((CALLBACK_NOT_PUBLIC, "Webhooks go to public addresses only.", None))
    if not records.has_webhook_secret():
        hint = "Have the operator make one with `multicap webhooks rotate`."
        found.append((WEBHOOK_SECRET_MISSING, "There is no secret to sign webhooks with.", hint))
    pointer = pointer_to(*field, "callback_url")
    return [ErrorItem(code=code, message=message, pointer=pointer, hint=hint) for code, message, hint in found]


def character_errors(spec: JobSpec, records: TenantRecords, *field: str) -> list[ErrorItem]:
    """Refuse an unknown character; ``field`` as of ``spec_errors``."""
    if spec.character is not None:
        try:
            records.characters.get(str(spec.character))
        except NotFound:
            message, hint = "There is no such character.", "GET /v1/characters lists them."
            pointer = pointer_to(*field, "character")
            return [ErrorItem(code=CHARACTER_UNKNOWN, message=message, pointer=pointer, hint=hint)]
    return []


def format_errors(spec: JobSpec, services: Services, field: tuple[str, ...] | None) -> list[ErrorItem]:
    """Refuse formats that not every worker can write; without workers, the job waits for one.

    ``field`` leads to the spec in the request; ``None``: the request has no spec.
    """
    writable = writable_formats(services.store.workers.all())
    if writable is None:
        return []
    pointer = None if field is None else pointer_to(*field, "exports")
    return [
        ErrorItem(code=problem.code, message=problem.message, pointer=pointer, hint=problem.hint)
        for problem in format_problems(spec.exports, writable)
    ]


def network_errors(spec: JobSpec, services: Services, field: tuple[str, ...] | None) -> list[ErrorItem]:
    """Refuse networks that are not installed on every worker; without workers, the job waits for one.

    For sessions of videos. ``field`` leads to the spec in the request; ``None``: the request has no spec.
    """
    installed = installed_detectors(services.store.workers.all())
    networks = networks_of(spec.config).names
    missing = [] if installed is None else [name for name in networks if name not in installed]
    if not missing:
        return []
    message = f"Networks of this job are not installed: {', '.join(missing)}."
    hint = install_command(*missing)
    choice = "profile" if spec.detector == "auto" else "detector"
    pointer = None if field is None else pointer_to(*field, choice)
    return [ErrorItem(code=DETECTOR_NOT_INSTALLED, message=message, pointer=pointer, hint=hint)]


def body_errors(spec: JobSpec, services: Services, field: tuple[str, ...] | None) -> list[ErrorItem]:
    """Refuse a body of files that is not installed on every worker; without workers, the job waits for one.

    ``field`` is that of ``network_errors``.
    """
    if spec.body == "capsules" or not any(FILE_FORMATS[export].has_body for export in spec.exports):
        return []
    installed = installed_bodies(services.store.workers.all())
    if installed is None or spec.body in installed:
        return []
    message = f"The body {spec.body} is not installed for files of this job."
    pointer = None if field is None else pointer_to(*field, "body")
    return [ErrorItem(code=BODY_NOT_INSTALLED, message=message, pointer=pointer, hint=INSTALL_BODY)]
