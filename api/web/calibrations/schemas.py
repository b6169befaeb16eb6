"""Bodies of requests for calibrations, and of their responses, as Pydantic models."""

import hashlib
import json
from typing import Annotated, Any, Literal, Self
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, Field

from api.web.contract.schemas import ID, SHA256, FindingOut, Id, NextCursor, RequestModel, ResponseModel, printable_name
from api.web.http.bodies.form_kinds import UploadedFootage
from api.web.jobs.schemas import JobError
from api.web.sessions.manifest import CameraManifest, Up
from pipeline.core.options import job_choices
from worker.store.model.session_records import Calibration
from worker.store.model.states import JobState

Method = Literal["file", "board", "people", "scene"]
Format = Literal[
    "multicap",
    "anipose",
    "caliscope",
    "opencv",
    "freemocap",
    "qca",
    "opencap",
    "easymocap",
    "colmap",
    "kalibr",
    "mamma",
]
LensModel = Literal["standard", "fisheye"]
MEDIA_TYPES: dict[Format, tuple[str, str]] = {
    "multicap": ("json", "application/json"),
    "anipose": ("toml", "application/toml"),
    "caliscope": ("toml", "application/toml"),
    "opencv": ("yml", "application/yaml"),
    "freemocap": ("toml", "application/toml"),
    "qca": ("qca.txt", "application/xml"),
    "opencap": ("zip", "application/zip"),
    "easymocap": ("zip", "application/zip"),
    "colmap": ("zip", "application/zip"),
    "kalibr": ("yaml", "application/yaml"),
    "mamma": ("yaml", "application/yaml"),
}
"""Ending and media type of each format."""

BOARD_PATTERN = r"^(chessboard|charuco):[0-9]{1,3}x[0-9]{1,3}(:[0-9A-Za-z_.]{1,20}){1,3}$"
"""Form of a board: `chessboard:...` or `charuco:...`."""

_STATES = {None: "failed"} | {state: str(state) for state in JobState} | {JobState.EXPIRED: "failed"}


_Coordinate = Annotated[float, Field(ge=-job_choices.MAX_POINT_M, le=job_choices.MAX_POINT_M)]
_Side = Annotated[int, Field(ge=1, le=100_000)]
_Pixel = Annotated[float, Field(ge=-1.0, le=100_000.0)]


class KnownPointSpec(RequestModel):
    """Point whose coordinates in the world are known, and where cameras see it. Unknown fields are refused."""

    name: Annotated[str, AfterValidator(printable_name)] = Field(min_length=1, max_length=100, examples=["door"])
    """Name of the point."""
    xyz_m: tuple[_Coordinate, _Coordinate, _Coordinate] = Field(examples=[[0.0, 1.5, 0.0]])
    """Coordinates in metres, right-handed axes, Z up."""
    seen_px: dict[str, tuple[_Pixel, _Pixel]] = Field(
        max_length=256, examples=[{"cam_0": [812.5, 640.0], "cam_1": [310.0, 655.5]}]
    )
    """Pixel x, y in the full picture of each camera that sees it, by the name of the camera."""

    def point(self) -> job_choices.KnownPoint:
        """Point as the pipeline takes it."""
        return job_choices.KnownPoint(
            self.name, self.xyz_m, tuple((camera, x, y) for camera, (x, y) in self.seen_px.items())
        )


class CalibrationSpec(RequestModel):
    """Choices of a calibration beside its files. Unknown fields are refused."""

    method: Method = Field(default="file", examples=["board"])
    """`file`: the part `calibration` in any supported format; `board`: made from `videos` of a board, or intrinsics
    from photographs, `images`; `people`: made from `videos`, or from a session, of people of known stature who walk
    about; `scene`: made at once from `known_points`, of which each camera sees four, or six if its lens is not given by
    `intrinsics`."""
    name: Annotated[str, AfterValidator(printable_name)] | None = Field(
        default=None, min_length=1, max_length=200, examples=["Studio B"]
    )
    """Name for people; by default the name of the file."""
    units: Literal["m", "cm", "mm"] | None = None
    """Unit of length of a file whose format does not state it. Null: metres; if they are not plausible, the answer
    `calibration_units_unstated` asks for it."""
    up: Up = "z"
    """Axis of a file that points up, after the turn that its format needs by itself: the world is turned so that it
    becomes Z."""
    board: str | None = Field(
        default=None,
        max_length=100,
        pattern=BOARD_PATTERN,
        examples=["chessboard:9x6:0.06", "charuco:7x5:0.06:0.045:DICT_4X4_50"],
    )
    """Board: `chessboard:COLSxROWS:SQUARE_M`, or `charuco:COLSxROWS:SQUARE_M:MARKER_M:DICTIONARY`."""
    stature_m: tuple[Annotated[float, Field(ge=job_choices.MIN_STATURE_M, le=job_choices.MAX_STATURE_M)], ...] = Field(
        default=(), max_length=job_choices.MAX_STATURES
    )
    """Statures of the people in metres, in any order; one is enough."""
    session_id: UUID | None = None
    """Session whose people serve; its cameras keep their intrinsics."""
    known_points: tuple[KnownPointSpec, ...] = Field(default=(), max_length=job_choices.MAX_KNOWN_POINTS)
    """Points that determine the world in place of the board on the floor, or of the people; of a scene, also the
    cameras' poses."""
    sizes_px: dict[str, tuple[_Side, _Side]] = Field(
        default={}, max_length=256, examples=[{"cam_0": [1920, 1080], "cam_1": [1920, 1080]}]
    )
    """Of a scene: width and height of each camera's picture; `intrinsics` may contain them."""
    cameras: tuple[CameraManifest, ...] = Field(default=(), max_length=256)
    """Names of cameras, and offsets and rates of their videos."""

    def choices(self, has_intrinsics: bool, has_photographs: bool) -> job_choices.CalibrationChoices | None:
        """Choices of the job; ``None`` for a calibration without a job."""
        if self.method in {"file", "scene"}:
            return None
        points = tuple(point.point() for point in self.known_points)
        return job_choices.CalibrationChoices(self.board, has_intrinsics, self.stature_m, points, has_photographs)


class UploadedCalibration(UploadedFootage, CalibrationSpec):
    """Calibration of uploaded files, each given by the id of its upload. Unknown fields are refused."""

    calibration: UUID | None = Field(default=None, description="Upload of a calibration file.")
    images: tuple[UUID, ...] = ()
    """Uploads of photographs of a board: for each camera a zip, named as the camera."""
    intrinsics: UUID | None = None
    """Upload of a calibration file whose intrinsics are kept, and poses ignored."""

    def uploads(self) -> list[tuple[str, UUID | str]]:
        """Part of the form and id or URL of each upload."""
        single = (("calibration", self.calibration), ("intrinsics", self.intrinsics))
        images = (("images", upload) for upload in self.images)
        return [*super().uploads(), *images, *((part, upload) for part, upload in single if upload is not None)]


class CalibrationChanges(RequestModel):
    """Changes of a calibration. Unknown fields are refused."""

    name: Annotated[str, AfterValidator(printable_name)] = Field(
        min_length=1, max_length=200, description="Name of the calibration for people.", examples=["Studio B, March"]
    )


class CalibratedCamera(ResponseModel):
    """Camera of a calibration: x = K (R X + t), with OpenCV's distortion."""

    name: str = Field(description="Name of the camera.", examples=["cam_0"])
    size_px: tuple[int, int] | None = Field(examples=[[1280, 720]])
    """Width and height of the picture; null if it is unknown."""
    matrix: tuple[tuple[float, float, float], ...] = Field(
        description="Camera matrix K, 3 x 3, in pixels.",
        examples=[[[1040.0, 0.0, 640.0], [0.0, 1040.0, 360.0], [0.0, 0.0, 1.0]]],
    )
    lens: LensModel = Field(default="standard", description="Distortion model: OpenCV's standard or fisheye model.")
    distortion: tuple[float, ...] = Field(examples=[[-0.12, 0.03, 0.0, 0.0, 0.0]])
    """Distortion coefficients in OpenCV's order."""
    rotation: tuple[tuple[float, float, float], ...] = Field(
        description="Rotation R from world to camera, 3 x 3.",
        examples=[[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]],
    )
    translation_m: tuple[float, float, float] = Field(examples=[[0.0, 1.5, 4.0]])
    """Translation t in metres."""
    position_m: tuple[float, float, float] = Field(examples=[[0.0, -4.0, 1.5]])
    """Position of the camera in the world."""


class CalibrationUrls(ResponseModel):
    """Paths of a calibration and of what belongs to it."""

    self: str = Field(description="Path of the calibration.", examples=[f"/v1/calibrations/{ID}"])
    file: str | None = Field(examples=[f"/v1/calibrations/{ID}/file"])
    """Path of the file; null until the calibration is ready."""
    job: str | None = Field(description="Path of the job that makes it; null for a file, or once it is deleted.")
    session: str | None = Field(description="Path of the session from which it is made.")


class CalibrationOut(ResponseModel):
    """Calibration: cameras with their intrinsics and poses."""

    id: Id
    name: str = Field(description="Name of the calibration for people.", examples=["Studio B"])
    method: Method = Field(description="How it was made.")
    state: Literal["queued", "running", "canceling", "canceled", "failed", "ready"] = Field(examples=["ready"])
    """`ready`, or the state of the job that makes it."""
    created_at: AwareDatetime = Field(description="Time of the creation.")
    source: dict[str, Any] = Field(examples=[{"file": "Calib.toml", "format": "TOML", "units": "m"}])
    """Of a file: its name `file`, `format`, `units` and `axes`; else the choices with which it is made."""
    warnings: tuple[FindingOut, ...] = Field(description="Warnings about the file, or of the report.")
    cameras: tuple[CalibratedCamera, ...] = Field(description="Cameras; none until the calibration is ready.")
    sha256: str | None = Field(examples=[SHA256])
    """SHA-256 of the file in Multicap's format: calibrations with equal cameras have equal ones. Null until the
    calibration is ready."""
    report: dict[str, Any] | None
    """Report of a calibration that was made: errors and views by camera, the world, warnings."""
    error: JobError | None = Field(description="Error that ended the job; null if it did not fail.")
    urls: CalibrationUrls

    @classmethod
    def from_calibration(cls, calibration: Calibration) -> Self:
        """Build the response from a calibration."""
        address = f"/v1/calibrations/{calibration.id}"
        is_ready, has_job = calibration.text is not None, calibration.job_state is not None
        text = calibration.text
        warnings = (calibration.report or calibration.source).get("warnings", ())
        return cls.from_record(
            calibration,
            state="ready" if is_ready else _STATES[calibration.job_state],
            source={name: value for name, value in calibration.source.items() if name != "warnings"},
            warnings=tuple(map(FindingOut.model_validate, warnings)),
            cameras=() if text is None else _cameras(text),
            sha256=None if text is None else hashlib.sha256(text.encode()).hexdigest(),
            error=calibration.problem,
            urls=CalibrationUrls(
                self=address,
                file=f"{address}/file" if is_ready else None,
                job=f"/v1/jobs/{calibration.id}" if has_job else None,
                session=f"/v1/sessions/{calibration.session_id}" if calibration.session_id and has_job else None,
            ),
        )


class PlannedPlace(ResponseModel):
    """Place of a person in a planned room, whose middle is the origin."""

    x_m: float = Field(description="Place along X.", examples=[-2.6])
    y_m: float = Field(description="Place along Y.", examples=[1.9])
    views: float = Field(description="Expected number of views of a joint.", examples=[4.2])
    error_mm: float | None = Field(examples=[12.5])
    """Expected error of a joint; null where it has fewer than two views."""


class RigPlan(ResponseModel):
    """Plan of a rig."""

    covered: float = Field(description="Share of the floor at which all joints are located.", examples=[0.86])
    places: tuple[PlannedPlace, ...] = Field(description="Middles of nine parts of the floor.")
    picture: str = Field(examples=["<svg></svg>"])
    """SVG document: the room from above, with expected errors as colours."""


class CalibrationPage(ResponseModel):
    """Page of calibrations, the newest calibration first."""

    calibrations: tuple[CalibrationOut, ...]
    next_cursor: NextCursor


def _cameras(text: str) -> tuple[CalibratedCamera, ...]:
    """Cameras of Multicap's own JSON, with their positions."""
    return tuple(
        CalibratedCamera(**camera, position_m=_position_m(camera["rotation"], camera["translation_m"]))
        for camera in json.loads(text)["cameras"]
    )


def _position_m(rotation: list[list[float]], translation_m: list[float]) -> tuple[float, float, float]:
    """Position -R^T t of a camera, to the micrometre."""
    x, y, z = (round(-sum(rotation[i][j] * translation_m[i] for i in range(3)), 6) + 0.0 for j in range(3))
    return x, y, z
