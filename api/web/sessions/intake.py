"""Intake of sessions: what arrived is checked."""

import contextlib
import hashlib
import json
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import uuid_utils
from opentelemetry import trace
from starlette.concurrency import run_in_threadpool

from api.web.dependencies import Services
from api.web.errors import ErrorItem, error_item, pointer_to, unprocessable
from api.web.http.bodies import form_kinds
from api.web.http.bodies.form import Form, ReceivedFile
from api.web.jobs.queueing import check_spec, spec_limits, with_session_choices
from api.web.sessions.manifest import CameraManifest, LaboratoryManifest, Manifest
from api.web.sessions.preflight import InvalidFilesError, allowance_s, further_wait_s
from api.web.sessions.receiving import Sent, adopted, document, sent_form
from api.web.sessions.schemas import UploadedCapture, UploadedSession
from api.web.sessions.storing import CheckedSession
from api.web.settings import Settings
from pipeline.capture.preflight_record import Preflight, PreflightTimebase
from pipeline.core.errors import Problem
from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import PAIRED_IN_SORTED_ORDER
from pipeline.core.problems.session_codes import KEYPOINTS_LAYOUT, LABORATORY_CLOCK, SESSION_TOO_LONG
from worker.store.errors import NotFound
from worker.store.model.session_records import Session
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

# Fields of a camera in the manifest that determine its frame times.
_OF_CAMERA = {"offset_s", "offset_std_s", "rate"}

NO_PREFLIGHT = Preflight((), PreflightTimebase(0.0, 25.0, 0), ())
"""Preflight of a session whose files are fetched."""

_tracer = trace.get_tracer("multicap")


@dataclass(frozen=True, slots=True)
class Arrival:
    """Files of a session with its documents."""

    form: Form
    manifest: Manifest | None  # ``None`` if it is wrong, like ``spec``; ``errors`` then tell why
    spec: JobSpec | None
    errors: tuple[ErrorItem, ...] = ()
    calibration_id: str | None = None  # Calibration that the session names in place of a file
    upload_ids: tuple[str, ...] = ()  # Uploads that the files are from

    def with_error(self, error: ErrorItem) -> "Arrival":
        """Return the arrival with one more error."""
        return replace(self, errors=(*self.errors, error))


async def check(owner: str, services: Services, records: TenantRecords, sent: Sent) -> CheckedSession:
    """Check a session: its files by the preflight, its documents, and both against the limits of the service.

    Files that are fetched are checked when they are there, by another call.

    Raises ``ApiError`` with all that is wrong.
    """
    awaited = awaited_names(sent)
    if isinstance(sent.content, UploadedSession):
        # Large files are read once, for their digests, in the turn of the checks.
        arrival = await services.checks.run(owner, _named, services, records, sent, sent.content)
    else:
        arrival = _parsed(sent)
    arrival = await run_in_threadpool(_with_calibration, records, arrival, sent.folder)
    form, errors = arrival.form, [*arrival.form.errors, *arrival.errors]
    if arrival.manifest:
        errors.extend(_misplaced_facts(arrival.manifest, form))
    preflight = None if awaited is None else NO_PREFLIGHT
    record_path, thumbnails = record_path_in(sent.folder), sent.folder / str(uuid_utils.uuid7())
    thumbnails.mkdir()
    if preflight is None and not form.errors and (form.points or form.files[form_kinds.CALIBRATION]):
        try:
            with _tracer.start_as_current_span("preflight"):
                preflight = await services.checks.run(
                    owner,
                    services.preflight.check,
                    preflight_arguments(form, arrival.manifest or Manifest(), services.settings.max_session_joints),
                    record_path,
                    allowance_s(form),
                    thumbnails,
                    further_wait_s=further_wait_s(form),
                )
        except InvalidFilesError as invalid:
            errors.extend(located(item, form, arrival.manifest or Manifest()) for item in invalid.errors)
    if preflight:
        errors.extend(error_item(problem) for problem in limit_problems(preflight, services.settings))
    if arrival.spec and sent.kind.has_job:
        limits = await run_in_threadpool(spec_limits, services, records, has_videos=bool(form.videos))
        problems = await run_in_threadpool(check_spec, arrival.spec, None if awaited else preflight, limits)
        errors.extend(error_item(problem, (form_kinds.SPEC,)) for problem in problems)
    if errors or preflight is None or arrival.manifest is None or arrival.spec is None:
        raise unprocessable(errors)
    preflight = replace(preflight, sync=arrival.manifest.sync, timeline=arrival.manifest.timeline)
    return CheckedSession(
        form,
        arrival.manifest,
        with_session_choices(arrival.spec, preflight),
        preflight,
        record_path,
        arrival.upload_ids,
        thumbnails,
        awaited,
    )


def awaited_names(sent: Sent) -> form_kinds.UploadedFootage | None:
    """Names of uploads and URLs, if some files are fetched."""
    names = sent.content
    return names if isinstance(names, form_kinds.UploadedFootage) and names.has_urls else None


def limit_problems(preflight: Preflight, settings: Settings) -> Iterator[Problem]:
    """Find properties of a session that exceed the limits of the operator."""
    if settings.max_duration_s is not None and preflight.duration_s > settings.max_duration_s:
        message = f"The capture lasts {preflight.duration_s:.2f} s; at most {settings.max_duration_s:g} s are taken."
        yield Problem(SESSION_TOO_LONG, message, hint="Cut it into several captures.")
    if settings.max_pixels is not None:
        for camera in preflight.cameras:
            width, height = camera.size_px
            if width * height > settings.max_pixels:
                message = f"Its frames have {width} x {height} pixels; at most {settings.max_pixels} are taken."
                yield Problem(request_codes.FRAMES_TOO_LARGE, message, file=camera.file, camera=camera.name)


def _parsed(sent: Sent) -> Arrival:
    """Parse the documents of a form."""
    form = sent_form(sent)
    manifest, manifest_errors = document(sent, form_kinds.MANIFEST, Manifest)
    spec, spec_problems = document(sent, form_kinds.SPEC, JobSpec)
    arrival = Arrival(form, manifest, spec, (*manifest_errors, *spec_problems))
    if (text := form.documents.get(form_kinds.CALIBRATION_ID)) is None:
        return arrival
    try:
        return replace(arrival, calibration_id=str(uuid.UUID(text.decode().strip().strip('"'))))
    except ValueError:
        message = "The part calibration_id must be the id of a calibration."
        return arrival.with_error(
            ErrorItem(code=request_codes.WRONG_FORMAT, message=message, pointer=pointer_to(form_kinds.CALIBRATION_ID))
        )


def _named(services: Services, records: TenantRecords, sent: Sent, names: UploadedSession) -> Arrival:
    """Build the arrival of a session that names uploads."""
    form = adopted(services, records, sent, names)
    spec = names.spec if isinstance(names, UploadedCapture) else JobSpec()
    calibration_id = str(names.calibration_id) if names.calibration_id else None
    manifest = names.manifest
    if (source_id := names.source_id()) is not None:
        with contextlib.suppress(NotFound):  # the form says so
            manifest = _as_before(manifest, records.sessions.get(source_id))
    return Arrival(form, manifest, spec, calibration_id=calibration_id, upload_ids=names.upload_ids())


def _as_before(manifest: Manifest, source: Session) -> Manifest:
    """Manifest of a copied session: what it leaves unset is as it was of the session whose footage is copied."""
    preflight = source.preflight
    before: dict[str, Any] = {
        "cameras": tuple(
            CameraManifest(
                name=recording.camera,
                file=recording.file,
                more_files=recording.more_files,
                offset_s=recording.offset_s,
                offset_std_s=recording.offset_std_s,
                rate=recording.frame_rate_hz,
            )
            for recording in preflight.recordings
        ),
        "clock": preflight.clock,
        "laboratory": LaboratoryManifest.model_validate(dict(preflight.laboratory)),
        "sync": preflight.sync,
        "timeline": preflight.timeline,
        "layout": preflight.layout.name if preflight.layout and preflight.layout.told_by == "choice" else None,
        "pair_by_order": any(finding.code == PAIRED_IN_SORTED_ORDER for finding in preflight.findings),
    }
    if not any(file.kind == form_kinds.TIMESTAMPS for file in source.files):
        before["frame_rate_hz"] = preflight.timebase.frame_rate_hz
    return manifest.model_copy(update={name: before[name] for name in before.keys() - manifest.model_fields_set})


def _with_calibration(records: TenantRecords, arrival: Arrival, folder: Path) -> Arrival:
    """Add the file of the stored calibration that a session names, if it names one."""
    if arrival.calibration_id is None:
        return arrival
    text = stored_calibration(records, arrival.calibration_id)
    if not isinstance(text, str):
        code, message, hint = text
        pointer = pointer_to(form_kinds.CALIBRATION_ID)
        return arrival.with_error(ErrorItem(code=code, message=message, pointer=pointer, hint=hint))
    name = f"calibration-{arrival.calibration_id}.json"
    path, content = folder / name, text.encode()
    path.write_bytes(content)
    file = ReceivedFile(name, path, len(content), hashlib.sha256(content).hexdigest())
    return replace(arrival, form=replace(arrival.form, files={**arrival.form.files, form_kinds.CALIBRATION: (file,)}))


def stored_calibration(records: TenantRecords, calibration_id: str) -> str | tuple[Code, str, str]:
    """Text of a stored calibration with poses; else code, sentence and hint about why there is none."""
    try:
        calibration = records.calibrations.get(calibration_id)
    except NotFound:
        return request_codes.CALIBRATION_UNKNOWN, "There is no such calibration.", "GET /v1/calibrations lists them."
    if calibration.text is None:
        hint = "Wait for its job, or see why it failed."
        return request_codes.CALIBRATION_UNMADE, "The calibration is not made yet.", hint
    if not (calibration.report or {"has_extrinsics": True})["has_extrinsics"]:
        message, hint = "The calibration has intrinsics, and no poses.", "Make one from videos that cameras share."
        return request_codes.CALIBRATION_UNPOSED, message, hint
    return calibration.text


def _facts_of_videos(manifest: Manifest) -> Iterator[ErrorItem]:
    """Find what a manifest states of cameras that is of videos alone."""
    for index, camera in enumerate(manifest.cameras):
        for field in ("offset_s", "offset_std_s", "rate", "more_files"):
            if getattr(camera, field):
                yield ErrorItem(
                    code=request_codes.CAMERAS_OF_KEYPOINTS,
                    message="Keypoints have timestamps or one frame rate, and a camera has one archive.",
                    camera=camera.name,
                    field=field,
                    pointer=pointer_to(form_kinds.MANIFEST, "cameras", index, field),
                    hint=f"Omit {field}: of a camera with keypoints only its file can be stated.",
                )


def _misplaced_facts(manifest: Manifest, form: Form) -> Iterator[ErrorItem]:
    """Find what a manifest states that belongs to other kinds of sessions."""
    if form.keypoints:
        yield from _facts_of_videos(manifest)
    elif form.points:
        for field in ("cameras", "layout", "pair_by_order"):
            if getattr(manifest, field):
                message, pointer = f"3D points have no cameras: omit {field}.", pointer_to(form_kinds.MANIFEST, field)
                yield ErrorItem(code=request_codes.CAMERAS_OF_KEYPOINTS, message=message, pointer=pointer)
    elif manifest.layout is not None:
        yield ErrorItem(
            code=KEYPOINTS_LAYOUT,
            message="A layout belongs to keypoints; detectors of videos have their own.",
            pointer=pointer_to(form_kinds.MANIFEST, "layout"),
            hint="Omit layout.",
        )
    if manifest.names and not form.points:
        pointer = pointer_to(form_kinds.MANIFEST, "names")
        yield ErrorItem(code=KEYPOINTS_LAYOUT, message="A table of names belongs to 3D points.", pointer=pointer)


def record_path_in(folder: Path) -> Path:
    """Path for the preflight's record; no file of the client's has such a name."""
    return folder / f"{uuid_utils.uuid7()}.npz"


def preflight_arguments(form: Form, manifest: Manifest, max_joints: int) -> list[str]:
    """Arguments of the preflight for a form."""
    paths: dict[str, list[str]] = {}
    for pointer, file in form.pointers().items():
        paths.setdefault(pointer.split("/")[1], []).append(str(file.path))
    arguments = [word for part, names in paths.items() for word in (f"--{part}", *names)]
    if manifest.units is not None:
        arguments.append(f"--units={manifest.units}")
    if manifest.up != "z" or (form.points and "up" in manifest.model_fields_set):
        arguments.append(f"--up={manifest.up}")
    if manifest.layout is not None:
        arguments.append(f"--layout={manifest.layout}")
    if form.points and manifest.names:
        arguments.append(f"--names={json.dumps(manifest.names)}")
    if manifest.clock != "declared":
        arguments.append(f"--clock={manifest.clock}")
    if manifest.cameras:
        said = [
            {
                "camera": camera.name,
                "file": camera.file,
                "more_files": camera.more_files,
                "offset_s": camera.offset_s,
                "offset_std_s": camera.offset_std_s,
                "frame_rate_hz": camera.rate,
            }
            for camera in manifest.cameras
        ]
        arguments.append(f"--recordings={json.dumps(said, ensure_ascii=False)}")
    if manifest.frame_rate_hz is not None:
        arguments.append(f"--frame-rate={manifest.frame_rate_hz!r}")
    if manifest.pair_by_order:
        arguments.append("--pair-by-order")
    if form.files.get(form_kinds.LABORATORY):
        arguments.append(f"--laboratory-facts={manifest.laboratory.model_dump_json()}")
    if form.keypoints:
        arguments.append(f"--max-joints={max_joints}")
    return arguments


def located(item: ErrorItem, form: Form, manifest: Manifest) -> ErrorItem:
    """Add the pointer of a problem: to the entry of a camera in the manifest, or to the part of a file in the form.

    Problems of a file in an archive point to the archive. Of several entries of a camera, the last one is wrong.
    """
    if item.code == LABORATORY_CLOCK:
        return item.model_copy(update={"pointer": pointer_to(form_kinds.MANIFEST, "laboratory")})
    if form.points and item.field in Manifest.model_fields:
        return item.model_copy(update={"pointer": pointer_to(form_kinds.MANIFEST, item.field)})
    if item.code == KEYPOINTS_LAYOUT and not form.points:
        return item.model_copy(update={"pointer": pointer_to(form_kinds.MANIFEST, "layout")})
    of_camera = [index for index, camera in enumerate(manifest.cameras) if camera.name == item.camera]
    if of_camera and ("recording" in item.code or item.field in _OF_CAMERA):
        stated = manifest.cameras[of_camera[-1]].model_fields_set
        field = [item.field] if item.field in stated else []
        return item.model_copy(update={"pointer": pointer_to(form_kinds.MANIFEST, "cameras", of_camera[-1], *field)})
    pointers = {file.name: pointer for pointer, file in form.pointers().items()}
    of_archive = {PurePosixPath(file.name).stem: pointers[file.name] for file in form.keypoints}
    file = item.file or ""
    pointer = pointers.get(file) or of_archive.get(file.split("/")[0])
    return item.model_copy(update={"pointer": pointer})
