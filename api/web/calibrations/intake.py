"""Intake of calibrations: their form, what each method needs, the check of the files, and the job that makes one."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

from api.web.calibrations.schemas import CalibrationSpec, Method, UploadedCalibration
from api.web.dependencies import Services
from api.web.errors import ErrorItem, error_item, pointer_to, unprocessable
from api.web.http.bodies.form import Form
from api.web.http.bodies.form_kinds import CALIBRATION, IMAGES, INTRINSICS, SPEC, VIDEOS, FormKind
from api.web.jobs.queueing import installed_on_workers
from api.web.sessions import intake as session_intake
from api.web.sessions.manifest import Manifest
from api.web.sessions.preflight import CalibrationContents, InvalidFilesError, allowance_s, further_wait_s
from api.web.sessions.receiving import Sent, with_spec
from api.web.sessions.storing import CheckedSession, stored
from pipeline.calibration.known_points.point_checks import point_problems
from pipeline.capture.preflight_record import Preflight
from pipeline.core.errors import listed
from pipeline.core.options.job_choices import CalibrationChoices
from pipeline.core.options.rules import installation_problems
from pipeline.core.problems.request_codes import MISSING_PART, NOT_A_CAPTURE, PART_NOT_ALLOWED
from worker.run import tracing
from worker.run.planning import has_points, has_videos, plan_job
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import Session
from worker.store.model.work import StagePlan
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

_BOARD, _STATURE, _SESSION, _POINTS, _SIZES = "board", "stature_m", "session_id", "known_points", "sizes_px"
_NEEDED: Mapping[Method, tuple[str, ...]] = {
    "file": (CALIBRATION,),
    "board": (VIDEOS, _BOARD),
    "people": (VIDEOS, _STATURE),
    "scene": (_POINTS,),
}
_ALLOWED: Mapping[Method, frozenset[str]] = {
    "file": frozenset({CALIBRATION}),
    "board": frozenset({VIDEOS, INTRINSICS, _BOARD, _POINTS}),
    "people": frozenset({VIDEOS, INTRINSICS, _STATURE, _POINTS}),
    "scene": frozenset({INTRINSICS, _POINTS, _SIZES}),
}
# A session takes the place of the files.
_NEEDED_OF_SESSION, _ALLOWED_OF_SESSION = (_STATURE,), frozenset({_STATURE, _SESSION, _POINTS})
# Photographs take the place of videos of a board, and give intrinsics only.
_NEEDED_OF_IMAGES, _ALLOWED_OF_IMAGES = (IMAGES, _BOARD), frozenset({IMAGES, _BOARD})
# Photographs have no times: their numbers count at a rate that is allowed.
_IMAGES_RATE_HZ = 25.0


@dataclass(frozen=True, slots=True)
class ReadyCalibration:
    """Calibration without a job: the contents of a file, or made from a scene."""

    source: Mapping[str, Any]  # See ``CalibrationOut.source``
    contents: CalibrationContents


@dataclass(frozen=True, slots=True)
class CheckedCalibration:
    """A calibration without errors."""

    spec: CalibrationSpec
    name: str
    content: ReadyCalibration | CheckedSession | Session  # Ready, videos that were sent, or a stored session
    has_intrinsics: bool = False  # True if the intrinsics of the cameras are given
    has_photographs: bool = False  # True if the files are photographs in place of videos
    upload_ids: tuple[str, ...] = ()  # Uploads that the files are from

    def choices(self) -> CalibrationChoices | None:
        """Choices of the job that makes it; ``None`` for a file."""
        return self.spec.choices(self.has_intrinsics, self.has_photographs)


async def check_calibration(owner: str, services: Services, records: TenantRecords, sent: Sent) -> CheckedCalibration:
    """Check a calibration: its choices and its files.

    Raises ``ApiError`` with all that is wrong.
    """
    form, spec, part, errors = await with_spec(owner, services, records, sent, CalibrationSpec)
    if spec is None:
        raise unprocessable(errors)
    errors += _method_errors(spec, form, part)
    if errors:
        raise unprocessable(errors)
    if spec.session_id is not None:
        return _of_session(services, records, spec, str(spec.session_id), part)
    if spec.method in {"file", "scene"}:
        return await _ready(services, owner, sent, form, spec, part)
    footage = await _checked_footage(services, owner, sent, form, spec, part)
    num_cameras = len(footage.preflight.cameras) or len(form.files[VIDEOS])
    name = spec.name or f"{spec.method}, {num_cameras} cameras"
    has_intrinsics, has_photographs = bool(form.files[INTRINSICS]), bool(form.files[IMAGES])
    return CheckedCalibration(spec, name, footage, has_intrinsics, has_photographs, sent.upload_ids)


def _of_session(
    services: Services, records: TenantRecords, spec: CalibrationSpec, session_id: str, part: str
) -> CheckedCalibration:
    """Check that a session's people can calibrate its cameras."""
    session = records.sessions.get(session_id)
    if session.purpose == "calibration":
        message = "The capture was sent for a calibration itself."
    else:
        message = "The capture has 3D points, and no cameras." if has_points(session) else ""
    if message:
        raise unprocessable([ErrorItem(code=NOT_A_CAPTURE, message=message, pointer=_pointer(part, _SESSION))])
    errors = _point_errors(spec, session.preflight, part)
    if has_videos(session):
        errors += _missing_networks(services)
    if errors:
        raise unprocessable(errors)
    return CheckedCalibration(spec, spec.name or f"people, {session.name}", session, has_intrinsics=True)


def _method_errors(spec: CalibrationSpec, form: Form, part: str) -> list[ErrorItem]:
    """Report what a method lacks, and what it has no use for; ``part`` leads to the choices in the request."""
    chosen = (
        (_BOARD, spec.board),
        (_STATURE, spec.stature_m),
        (_SESSION, spec.session_id),
        (_POINTS, spec.known_points),
        (_SIZES, spec.sizes_px),
    )
    given = {name for name, value in chosen if value}
    of_session = spec.method == "people" and spec.session_id is not None
    needed = _NEEDED_OF_SESSION if of_session else _NEEDED[spec.method]
    allowed = _ALLOWED_OF_SESSION if of_session else _ALLOWED[spec.method]
    given |= {name for name, files in form.files.items() if files}
    if spec.method == "board" and IMAGES in given:
        needed, allowed = _NEEDED_OF_IMAGES, _ALLOWED_OF_IMAGES

    def pointer(name: str) -> str:
        return pointer_to(name) if name in form.files else _pointer(part, name)

    # Parts that an error names already have no files.
    reported = {part for error in form.errors for part in (error.pointer or "").split("/")[1:2]}
    errors = [
        ErrorItem(code=MISSING_PART, message=f"The method {spec.method} needs {name}.", pointer=pointer(name))
        for name in needed
        if name not in given and name not in reported
    ]
    errors += [
        ErrorItem(
            code=PART_NOT_ALLOWED, message=f"The method {spec.method} has no use for {name}.", pointer=pointer(name)
        )
        for name in sorted(given - allowed)
    ]
    return errors


def _point_errors(spec: CalibrationSpec, preflight: Preflight, part: str) -> list[ErrorItem]:
    """Report what is wrong with the known points, now that the cameras are known."""
    if not spec.known_points:
        return []
    points = tuple(point.point() for point in spec.known_points)
    problems = point_problems(points, {camera.name: camera.size_px for camera in preflight.cameras})
    steps = (part,) if part else ()
    return [error_item(replace(problem, field=_POINTS, file=None), steps) for problem in listed(problems)]


def _missing_networks(services: Services) -> list[ErrorItem]:
    installed = installed_on_workers(services, has_videos=True)
    return [error_item(problem, None) for problem in installation_problems(JobSpec().config, installed)]


def _pointer(part: str, field: str) -> str:
    return pointer_to(part, field) if part else pointer_to(field)


async def _ready(
    services: Services,
    owner: str,
    sent: Sent,
    form: Form,
    spec: CalibrationSpec,
    part: str,
) -> CheckedCalibration:
    """Read a calibration file, or make the calibration of a scene, in a child process."""
    folder, source = sent.folder, dict[str, Any]()
    try:
        if spec.method == "file":
            (file,) = form.files[CALIBRATION]
            name, source = file.name, {"file": file.name}
            arguments = ["--calibration", str(file.path), f"--up={spec.up}"]
            if spec.units is not None:
                arguments.append(f"--units={spec.units}")
            contents = await services.checks.run(owner, services.preflight.read_calibration, arguments, folder)
        else:
            points = [point.point() for point in spec.known_points]
            name, source = f"scene, {len(points)} points", {_POINTS: list(map(asdict, points)), _SIZES: spec.sizes_px}
            lenses = next((str(file.path) for file in form.files[INTRINSICS]), None)
            scene = {_POINTS: list(map(astuple, points)), _SIZES: spec.sizes_px, INTRINSICS: lenses, "up": spec.up}
            made = await services.checks.run(owner, services.preflight.calibration_task, "scene", scene, folder)
            contents = CalibrationContents.model_validate(made)
    except InvalidFilesError as invalid:
        pointers = {field: _pointer(part, name) for field, name in ((_POINTS, _POINTS), ("size", _SIZES))}
        raise unprocessable(
            [
                item.model_copy(update={"pointer": pointers[item.field], "field": None})
                if spec.method == "scene" and item.file is None and item.field in pointers
                else session_intake.located(item, form, Manifest())
                for item in invalid.errors
            ]
        ) from None
    source |= contents.model_dump(mode="json", exclude={"text", "report"})
    return CheckedCalibration(spec, spec.name or name, ReadyCalibration(source, contents), upload_ids=sent.upload_ids)


async def _checked_footage(
    services: Services,
    owner: str,
    sent: Sent,
    form: Form,
    spec: CalibrationSpec,
    part: str,
) -> CheckedSession:
    """Check the videos or photographs of a calibration, as a session with guessed or given intrinsics."""
    photographs = form.files[IMAGES]
    manifest = Manifest(
        name=spec.name or f"Calibration from {spec.method}",
        cameras=spec.cameras,
        units=spec.units,
        frame_rate_hz=_IMAGES_RATE_HZ if photographs else None,
    )
    if (awaited := session_intake.awaited_names(sent)) is not None:
        if spec.method == "people" and (errors := _missing_networks(services)):
            raise unprocessable(errors)
        return CheckedSession(
            form,
            manifest,
            JobSpec(),
            session_intake.NO_PREFLIGHT,
            session_intake.record_path_in(sent.folder),
            (),
            None,
            awaited,
        )
    # From here on photographs are sequences of images.
    footage = replace(form, files={**form.files, VIDEOS: photographs, IMAGES: ()}) if photographs else form
    record_path = session_intake.record_path_in(sent.folder)
    arguments = session_intake.preflight_arguments(footage, manifest, services.settings.max_session_joints)
    if photographs:
        arguments.append("--photographs")
    if spec.board is not None:
        arguments.append(f"--board={spec.board}")
    try:
        preflight = await services.checks.run(
            owner,
            services.preflight.check,
            arguments,
            record_path,
            allowance_s(footage),
            further_wait_s=further_wait_s(footage),
        )
    except InvalidFilesError as invalid:
        raise unprocessable([session_intake.located(item, form, manifest) for item in invalid.errors]) from None
    errors = [error_item(problem) for problem in session_intake.limit_problems(preflight, services.settings)]
    errors += _point_errors(spec, preflight, part)
    if spec.method == "people":
        errors += _missing_networks(services)
    if errors:
        raise unprocessable(errors)
    return CheckedSession(footage, manifest, JobSpec(), preflight, record_path, sent.upload_ids)


@contextlib.contextmanager
def begun_calibration(
    services: Services, records: TenantRecords, checked: CheckedCalibration
) -> Iterator[tuple[TenantRecords, JobRecord]]:
    """Store what was sent for a calibration, and record it with the job that makes it; all or nothing.

    The block gets the open transaction and the job. A worker is woken after it.
    """
    content, making, provider = checked.content, checked.choices(), services.store.workers.provider()
    if isinstance(content, ReadyCalibration):
        raise TypeError("the calibration is made already")
    if isinstance(content, Session):
        services.disk.require_room()
        stages = plan_job(content, JobSpec(), making=making, provider=provider)
        with records.transaction() as work:
            yield work, _begin(services, work, checked, content.id, stages)
    else:
        with stored(services, content) as new:
            is_awaited = new.arrival is not None
            stages = () if is_awaited else plan_job(new, JobSpec(), making=making, provider=provider)
            with records.transaction() as work:
                new.add_to(work, "calibration")
                yield work, _begin(services, work, checked, new.id, stages)
    # When the broker is away, the reaper publishes later.
    services.queue.publish()


def _begin(
    services: Services, work: TenantRecords, checked: CheckedCalibration, session_id: str, stages: tuple[StagePlan, ...]
) -> JobRecord:
    """Queue the job of a calibration in an open transaction, which records both."""
    retention_s = services.settings.retention_s
    job = work.jobs.add(session_id, JobSpec(), stages, retention_s, tracing.current(), checked.choices())
    work.calibrations.begin(job, checked.name)
    return job


CALIBRATION_FORM = FormKind(
    name="CalibrationForm",
    noun="calibration",
    parts={
        CALIBRATION: "Calibration file, for the method `file`.",
        VIDEOS: "Videos of a board or of people.",
        IMAGES: "Photographs of a board in place of videos: for each camera a zip, named as the camera.",
        INTRINSICS: "Calibration file whose intrinsics are kept, and poses ignored.",
    },
    documents={SPEC: CalibrationSpec},
    uploaded=UploadedCalibration,
)
