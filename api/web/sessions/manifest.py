"""Manifest of a capture session: facts that its client states about cameras, layouts, axes and instruments."""

import json
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from api.web.contract.schemas import RequestModel, printable_name
from pipeline.capture.preflight_record import Clock
from pipeline.core.options.job_choices import Units
from pipeline.core.problems.request_codes import JSON_VALUE


def _json(value: dict[str, Any]) -> dict[str, Any]:
    """Refuse values that Python's parser accepts and JSON does not allow, such as NaN and lone surrogates."""
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except ValueError:
        message = "metadata must be valid JSON: no NaN, no infinity, no lone surrogates."
        raise PydanticCustomError(JSON_VALUE, message) from None
    return value


Layout = Literal[
    "coco-17",
    "coco-wholebody-23",
    "coco-wholebody-133",
    "halpe-26",
    "halpe-136",
    "body-25",
    "coco-18",
    "trt-pose-18",
    "body-25b",
    "mediapipe-33",
    "human36m-17",
]
Up = Literal["x", "-x", "y", "-y", "z", "-z"]

SessionName = Annotated[
    str,
    AfterValidator(printable_name),
    Field(min_length=1, max_length=200, description="Name of the session for people.", examples=["Handshake, take 3"]),
]


class CameraManifest(RequestModel):
    """Facts about a camera's video that neither the file nor the calibration states.

    Of a camera with keypoints only ``file`` can be stated.
    """

    name: Annotated[str, AfterValidator(printable_name)] = Field(min_length=1, max_length=64, examples=["cam_1"])
    """Name of the camera in the calibration."""
    file: Annotated[str, AfterValidator(printable_name)] | None = Field(
        default=None, min_length=1, max_length=200, examples=["GX010042.mp4"]
    )
    """Name of the camera's video, or of its archive of keypoints; by default the one with the camera's name."""
    more_files: tuple[Annotated[str, AfterValidator(printable_name), Field(min_length=1, max_length=200)], ...] = Field(
        default=(), max_length=256
    )
    """Names of further files in which the recording of `file` goes on, in order. Chapters of GoPro cameras, and files
    with `part 1`, `part 2` in their names, need no mention."""
    offset_s: float = Field(default=0.0, strict=True, ge=-86_400.0, le=86_400.0, allow_inf_nan=False, examples=[0.48])
    """Time of the first frame on the clock that all cameras share."""
    offset_std_s: float | None = Field(default=None, strict=True, ge=0.0, le=3600.0, allow_inf_nan=False)
    """Standard deviation of `offset_s`; with it `sync: auto` measures the clock within the uncertainty, and uses what
    is beyond it with a warning alone. Null: nothing is known of it."""
    rate: float | None = Field(default=None, strict=True, ge=1.0, le=1000.0, allow_inf_nan=False)
    """Frame rate in Hz, if the times in the video are wrong, or of images in place of a video."""


Place = Annotated[float, Field(strict=True, ge=-10_000.0, le=10_000.0, allow_inf_nan=False)]


class LaboratoryManifest(RequestModel):
    """Facts about the C3D file of a laboratory. Unknown fields are refused."""

    clock: Literal["auto", "timecode", "trigger", "contacts"] = "auto"
    """Clock of the file's beginning: `timecode` of the file and of a video; a `trigger` channel that rises as the
    first frame is taken; `contacts` of feet and the vertical force; `auto`: the first of these that the files allow."""
    channel: str | None = Field(default=None, max_length=100)
    """Name of the trigger channel; null: by its name and its two levels."""
    place: tuple[Place, Place, Place, Place] | None = Field(default=None, examples=[[0.5, 0.0, 0.0, 90.0]])
    """Place of the laboratory's axes in the world: x, y, z in metres, and degrees about the vertical. Null: the
    calibration has the laboratory's axes."""


class Manifest(RequestModel):
    """Description of a session beside its files. Unknown fields are refused."""

    name: SessionName = "untitled"
    frame_rate_hz: float | None = Field(default=None, strict=True, ge=1.0, le=1000.0, allow_inf_nan=False)
    """Frame rate of keypoints without timestamps, or of 3D points without times, which need one; or of images in place
    of videos, which need one unless their cameras have a `rate`."""
    cameras: tuple[CameraManifest, ...] = Field(
        default=(), max_length=256, examples=[[{"name": "cam_1", "file": "GX010042.mp4", "offset_s": 0.48}]]
    )
    """Facts about some cameras; of keypoints only their files."""
    pair_by_order: bool = Field(default=False, strict=True)
    """True if videos or keypoints whose cameras `cameras` does not state are paired with the other cameras by the
    natural order of their names. By default a camera's name is a whole word in the name of its file."""
    units: Units | None = Field(default=None, examples=["mm"])
    """Unit of length of a calibration whose format does not state it (such as TOML). Null: metres; if they are not
    plausible, the answer `calibration_units_unstated` asks for it."""
    up: Up = "z"
    """Axis of the calibration that points up, after the turn that its format needs by itself: the world is turned so
    that it becomes Z. Of 3D points the people tell it unless it is stated."""
    names: dict[str, str] = Field(default={}, max_length=1000, examples=[{"Knie links": "left_knee"}])
    """Of 3D points: joints, such as `left_knee`, by names of points that the formats do not define."""
    layout: Layout | None = None
    """Layout of the points of keypoints whose files do not name them. Null: the number of points and the people tell
    it; if they do not, the answer `keypoints_layout` asks for it."""
    clock: Clock = "declared"
    """Clock of the first frames of videos: `declared` is their start plus `offset_s`; `timecode` and `creation_time`
    are those that the files state, to which `offset_s` is added."""
    laboratory: LaboratoryManifest = LaboratoryManifest()
    """Facts about the file of the part `laboratory`."""
    sync: Literal["declared", "auto"] = "declared"
    """Synchronisation of the session's jobs whose spec does not state `sync`: `auto` measures the clocks of the cameras
    from the people."""
    timeline: Literal["take", "person"] = "take"
    """Frames of the files of the session's jobs whose spec does not state `timeline`: all frames of the take, or the
    frames in which the person is there."""
    metadata: Annotated[dict[str, Any], AfterValidator(_json)] = Field(default={}, examples=[{"scene": 12}])
    """Data of the client, which every response with the session repeats."""
