"""Intake of calibrations, from a form or from uploads: what each method needs, and the check of the files."""

from collections.abc import Mapping
from dataclasses import dataclass

from fastapi import Request

from api.dependencies import Services
from api.errors import ErrorItem, pointer_to, unprocessable
from api.requests.form import CALIBRATION, CALIBRATION_FORM, INTRINSICS, VIDEOS, Form, ReceivedFile
from api.requests.intake import (
    SPEC,
    CheckedSession,
    Sent,
    adopted,
    arguments_of,
    document,
    located,
    record_path_in,
)
from api.requests.preflight import CalibrationContents, InvalidFilesError, allowance_s, further_wait_s
from api.requests.spec_checks import limit_errors, network_errors
from api.schemas.calibrations import CalibrationSpec, Method, UploadedCalibration
from api.schemas.captures import Manifest
from worker.jobs.model import Session
from worker.jobs.spec import JobSpec
from worker.jobs.tenant_records import TenantRecords
from worker.planning import has_videos

_BOARD, _STATURE, _SESSION = "board", "stature_m", "session_id"
_NEEDED: Mapping[Method, tuple[str, ...]] = {
    "file": (CALIBRATION,),
    "board": (VIDEOS, _BOARD),
    "people": (VIDEOS, _STATURE),
}
_ALLOWED: Mapping[Method, frozenset[str]] = {
    "file": frozenset({CALIBRATION}),
    "board": frozenset({VIDEOS, INTRINSICS, _BOARD}),
    "people": frozenset({VIDEOS, INTRINSICS, _STATURE}),
}
# A session takes the place of the files.
_NEEDED_OF_SESSION, _ALLOWED_OF_SESSION = (_STATURE,), frozenset({_STATURE, _SESSION})


@dataclass(frozen=True, slots=True)
class ReadFile:
    """Calibration file, and what it contains."""

    file: ReceivedFile
    contents: CalibrationContents


@dataclass(frozen=True, slots=True)
class CheckedCalibration:
    """A calibration without errors.

    Parameters
    ----------
    content
        A file, videos that were sent, or a session that is there already.
    has_intrinsics
        Whether the intrinsics of the cameras are given.
    upload_ids
        Uploads that the files are from.
    """

    spec: CalibrationSpec
    name: str
    content: ReadFile | CheckedSession | Session
    has_intrinsics: bool = False
    upload_ids: tuple[str, ...] = ()


async def check_calibration(
    request: Request, services: Services, records: TenantRecords, sent: Sent
) -> CheckedCalibration:
    """Check a calibration: its choices and its files.

    Raises
    ------
    ApiError
        With all that is wrong.
    """
    owner = request.state.caller.owner
    if isinstance(sent.content, UploadedCalibration):
        spec: CalibrationSpec | None = sent.content
        # Large files are read once, for their digests, in the turn of the checks.
        form = await services.checks.run(owner, adopted, services, records, sent.folder, sent.content, CALIBRATION_FORM)
        part, upload_ids, errors = "", sent.content.upload_ids(), [*form.errors]
    else:
        form = _form_of(sent)
        spec, spec_problems = document(form, SPEC, CalibrationSpec)
        part, upload_ids, errors = SPEC, (), [*form.errors, *spec_problems]
    if spec is None:
        raise unprocessable(errors)
    errors += _method_errors(spec, form, part)
    if errors:
        raise unprocessable(errors)
    if spec.session_id is not None:
        return _of_session(services, records, spec, str(spec.session_id), part)
    if spec.method == "file":
        (file,) = form.files[CALIBRATION]
        contents = await _contents(services, owner, sent, form, spec)
        return CheckedCalibration(spec, spec.name or file.name, ReadFile(file, contents), upload_ids=upload_ids)
    videos = await _checked_videos(services, owner, sent, form, spec, upload_ids)
    name = spec.name or f"{spec.method}, {len(form.videos)} cameras"
    return CheckedCalibration(spec, name, videos, has_intrinsics=bool(form.files[INTRINSICS]), upload_ids=upload_ids)


def _of_session(
    services: Services, records: TenantRecords, spec: CalibrationSpec, session_id: str, part: str
) -> CheckedCalibration:
    """Check that a session's people can calibrate its cameras."""
    session = records.sessions.get(session_id)
    if session.purpose == "calibration":
        message = "The session was sent for a calibration itself."
        error = ErrorItem(code="not_a_capture", message=message, pointer=_pointer(part, _SESSION))
        raise unprocessable([error])
    if has_videos(session) and (errors := network_errors(JobSpec(), services, None)):
        raise unprocessable(errors)
    return CheckedCalibration(spec, spec.name or f"people, {session.name}", session, has_intrinsics=True)


def _form_of(sent: Sent) -> Form:
    if not isinstance(sent.content, Form):
        raise TypeError("a calibration is a form or names uploads")
    return sent.content


def _method_errors(spec: CalibrationSpec, form: Form, part: str) -> list[ErrorItem]:
    """Report what a method lacks, and what it has no use for; ``part`` leads to the choices in the request."""
    chosen = ((_BOARD, spec.board), (_STATURE, spec.stature_m), (_SESSION, spec.session_id))
    given = {name for name, value in chosen if value}
    of_session = spec.method == "people" and spec.session_id is not None
    needed = _NEEDED_OF_SESSION if of_session else _NEEDED[spec.method]
    allowed = _ALLOWED_OF_SESSION if of_session else _ALLOWED[spec.method]
    given |= {name for name, files in form.files.items() if files}

    def pointer(name: str) -> str:
        return pointer_to(name) if name in form.files else _pointer(part, name)

    errors = [
        ErrorItem(code="missing_part", message=f"The method {spec.method} needs {name}.", pointer=pointer(name))
        for name in needed
        if name not in given and not _is_reported(form, name)
    ]
    errors += [
        ErrorItem(
            code="part_not_allowed", message=f"The method {spec.method} has no use for {name}.", pointer=pointer(name)
        )
        for name in sorted(given - allowed)
    ]
    return errors


def _pointer(part: str, field: str) -> str:
    return pointer_to(part, field) if part else pointer_to(field)


def _is_reported(form: Form, part: str) -> bool:
    """Whether an error already names a part, whose files then are missing."""
    return any((error.pointer or "").split("/")[1:2] == [part] for error in form.errors)


async def _contents(
    services: Services, owner: str, sent: Sent, form: Form, spec: CalibrationSpec
) -> CalibrationContents:
    """Read the calibration file in a child process."""
    (file,) = form.files[CALIBRATION]
    arguments = ["--calibration", str(file.path), "--units", spec.units]
    try:
        return await services.checks.run(owner, services.preflight.read_calibration, arguments, sent.folder)
    except InvalidFilesError as invalid:
        raise unprocessable([located(item, form, Manifest()) for item in invalid.errors]) from None


async def _checked_videos(
    services: Services, owner: str, sent: Sent, form: Form, spec: CalibrationSpec, upload_ids: tuple[str, ...]
) -> CheckedSession:
    """Check the videos of a calibration that is to be made, as a session with guessed or given intrinsics."""
    manifest = Manifest(name=spec.name or f"Calibration from {spec.method}", cameras=spec.cameras, units=spec.units)
    record_path = record_path_in(sent.folder)
    arguments = arguments_of(form, manifest, services.settings.max_session_joints)
    if spec.board is not None:
        arguments.append(f"--board={spec.board}")
    try:
        preflight = await services.checks.run(
            owner,
            services.preflight.check,
            arguments,
            record_path,
            allowance_s(form),
            further_wait_s=further_wait_s(form),
        )
    except InvalidFilesError as invalid:
        raise unprocessable([located(item, form, manifest) for item in invalid.errors]) from None
    errors = limit_errors(services, preflight)
    if spec.method == "people":
        errors += network_errors(JobSpec(), services, None)
    if errors:
        raise unprocessable(errors)
    return CheckedSession(form, manifest, JobSpec(), preflight, record_path, upload_ids)
