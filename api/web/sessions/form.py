"""Forms that create sessions, alone or with their reconstruction."""

from collections.abc import Iterator, Mapping

from api.web.http.bodies import form_kinds
from api.web.sessions.schemas import Manifest, UploadedCapture, UploadedSession
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import MISSING_PART, PART_NOT_ALLOWED
from worker.store.spec import JobSpec


def _session_faults(counts: Mapping[str, int]) -> Iterator[tuple[Code, str, str]]:
    if not any(counts[part] for part in form_kinds.VIEWS):
        yield MISSING_PART, "There are no videos and no keypoints: a session needs either.", form_kinds.VIDEOS
    if not counts[form_kinds.CALIBRATION] and not counts[form_kinds.CALIBRATION_ID]:
        yield MISSING_PART, "There is no calibration: a session needs one.", form_kinds.CALIBRATION
    if counts[form_kinds.CALIBRATION] and counts[form_kinds.CALIBRATION_ID]:
        message = "There is a calibration and a calibration_id: a session needs one of both."
        yield PART_NOT_ALLOWED, message, form_kinds.CALIBRATION_ID
    if counts[form_kinds.VIDEOS]:
        for part in (form_kinds.KEYPOINTS, form_kinds.TIMESTAMPS):
            if counts[part]:
                yield PART_NOT_ALLOWED, "A session of videos has no such files.", part


_PARTS: Mapping[str, str] = {
    form_kinds.VIDEOS: "Videos, one for each camera.",
    form_kinds.KEYPOINTS: "Keypoints in place of videos: for each camera a zip of its keypoint files, named as the "
    "camera or stated in `cameras` of the manifest; or FreeMoCap's array of all cameras, which `pair_by_order` of the "
    "manifest pairs with the cameras.",
    form_kinds.CALIBRATION: "Calibration of all cameras; or `calibration_id`.",
    form_kinds.TIMESTAMPS: "Timestamps of keypoints: CSV with the columns camera, frame and time_s.",
}

SESSION_FORM = form_kinds.FormKind(
    name="SessionForm",
    noun="session",
    parts=_PARTS,
    documents={form_kinds.CALIBRATION_ID: None, form_kinds.MANIFEST: Manifest},
    uploaded=UploadedSession,
    faults=_session_faults,
)
CAPTURE_FORM = form_kinds.FormKind(
    name="CaptureForm",
    noun="session",
    parts=_PARTS,
    documents={form_kinds.CALIBRATION_ID: None, form_kinds.MANIFEST: Manifest, form_kinds.SPEC: JobSpec},
    uploaded=UploadedCapture,
    faults=_session_faults,
    has_job=True,
)
"""A session that is reconstructed at once."""
