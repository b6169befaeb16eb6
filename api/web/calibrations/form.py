"""Form that creates calibrations.

What a calibration needs depends on its method, which is in a document: that is checked when the document is parsed.
"""

from api.web.calibrations import examples
from api.web.calibrations.schemas import CalibrationSpec, UploadedCalibration
from api.web.contract.examples import UPLOAD_IDS
from api.web.http.bodies.form_kinds import CALIBRATION, IMAGES, INTRINSICS, SPEC, VIDEOS, FormKind

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
    form_example={VIDEOS: ["cam_0.mp4", "cam_1.mp4"], SPEC: examples.SPEC},
    uploaded_example={VIDEOS: UPLOAD_IDS[:2], **examples.SPEC},
)
