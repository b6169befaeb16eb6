"""Kinds of forms that create sessions and calibrations: names of their parts, models of their documents, faults."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from pydantic import BaseModel

from api.schemas.calibrations import CalibrationSpec, UploadedCalibration
from api.schemas.captures import Manifest, UploadedCapture, UploadedFiles, UploadedSession
from worker.jobs.spec import JobSpec

VIDEOS, KEYPOINTS, CALIBRATION, TIMESTAMPS = "videos", "keypoints", "calibration", "timestamps"
INTRINSICS, IMAGES = "intrinsics", "images"
VIEWS = (VIDEOS, KEYPOINTS, IMAGES)
"""Parts with a file for each camera; the other parts have one file."""

MANIFEST, SPEC = "manifest", "spec"

FORM_TYPE, JSON_TYPE = "multipart/form-data", "application/json"
"""Content types of the bodies: a form, and JSON that names uploads."""
EITHER_TYPE = (FORM_TYPE, JSON_TYPE)

CALIBRATION_ID = "calibration_id"
"""Document that names a stored calibration in place of a file."""

SESSION_ID = "session_id"
"""Field that names a stored session whose footage is used in place of files."""


@dataclass(frozen=True, slots=True)
class FormKind:
    """Kind of a form.

    Parameters
    ----------
    name
        Name of the form's schema in the contract.
    noun
        What is sent, for problems.
    parts
        Names of the parts with files.
    documents
        Names of the other parts, with the models of their JSON; ``None`` for an id.
    uploaded
        Model of the JSON that takes the form's place and names uploads.
    faults
        Code, sentence and part of each fault of a complete form, by the numbers of its files and documents.
    """

    name: str
    noun: str
    parts: tuple[str, ...]
    documents: Mapping[str, type[BaseModel] | None]
    uploaded: type[UploadedFiles]
    faults: Callable[[Mapping[str, int]], Iterable[tuple[str, str, str]]]


def _session_faults(counts: Mapping[str, int]) -> Iterator[tuple[str, str, str]]:
    if not any(counts[part] for part in VIEWS):
        yield "missing_part", "There are no videos and no keypoints: a session needs either.", VIDEOS
    if not counts[CALIBRATION] and not counts[CALIBRATION_ID]:
        yield "missing_part", "There is no calibration: a session needs one.", CALIBRATION
    if counts[CALIBRATION] and counts[CALIBRATION_ID]:
        message = "There is a calibration and a calibration_id: a session needs one of both."
        yield "part_not_allowed", message, CALIBRATION_ID
    if counts[VIDEOS]:
        for part in (KEYPOINTS, TIMESTAMPS):
            if counts[part]:
                yield "part_not_allowed", "A session of videos has no such files.", part


_OF_SESSION = (VIDEOS, KEYPOINTS, CALIBRATION, TIMESTAMPS)

SESSION_FORM = FormKind(
    "SessionForm",
    "session",
    _OF_SESSION,
    {CALIBRATION_ID: None, MANIFEST: Manifest},
    UploadedSession,
    _session_faults,
)
CAPTURE_FORM = FormKind(
    "CaptureForm",
    "session",
    _OF_SESSION,
    {CALIBRATION_ID: None, MANIFEST: Manifest, SPEC: JobSpec},
    UploadedCapture,
    _session_faults,
)
"""A session that is reconstructed at once."""
# What a calibration needs depends on its method, which is in a document: checked when that is parsed.
CALIBRATION_FORM = FormKind(
    "CalibrationForm",
    "calibration",
    (CALIBRATION, VIDEOS, IMAGES, INTRINSICS),
    {SPEC: CalibrationSpec},
    UploadedCalibration,
    lambda counts: (),
)
