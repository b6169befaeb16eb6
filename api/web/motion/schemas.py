"""Bodies of motion for viewers. They declare what the export has written; the service sends its file as it is."""

from typing import Any

from pydantic import Field

from api.web.contract.schemas import ResponseModel


class MotionSkeleton(ResponseModel):
    """Joints of the animation skeleton."""

    names: tuple[str, ...] = Field(description="Names of the joints, in the order of the records' positions.")
    parents: tuple[int | None, ...] = Field(description="Number of each joint's parent; null of the root.")


class MotionRecord(ResponseModel):
    """Structure of the record of a frame."""

    num_bytes: int = Field(description="Size of a record.")
    offsets: dict[str, int] = Field(description="First byte of each field; docs/formats.md describes the fields.")
    absent: int = Field(description="Coordinate of a joint without a position, and number of an angle that is unknown.")
    angle_step_deg: float | None = Field(
        default=None, description="Step of quantised joint angles; null of results that have none."
    )
    error_step_px: float = Field(description="Step of quantised reprojection errors.")
    unknown_error: int = Field(description="Value of an error that is not known.")


class MotionDoubt(ResponseModel):
    """Moment at which a person may have been taken for another one."""

    frame: int = Field(description="Output frame from which on the other choice differs.")
    confidence: float = Field(description="Probability of the choice.")
    other: int | None = Field(description="Person who would go on as this one; null if it is nobody else.")


class MotionIdentity(ResponseModel):
    """Confidence in a person's identity."""

    confidence: float = Field(description="Probability that the person is one and the same all the time.")
    doubts: tuple[MotionDoubt, ...] = Field(description="Doubtful moments.")


class MotionPerson(ResponseModel):
    """Person of the motion."""

    id: int = Field(description="Number of the person.")
    name: str = Field(description="Name of the person, as in the names of result files.")
    color: str = Field(description="Colour of the person in pictures and models, `#rrggbb`.")
    start_frame: int = Field(description="First output frame.")
    num_frames: int = Field(description="Number of frames.")
    offset_bytes: int = Field(description="First byte of the person's records, without heads.")
    position_step_m: float = Field(description="Step of quantised positions.")
    coverage: float | None = Field(description="Share of measured joints.")
    stature_m: float | None = Field(description="Estimated stature.")
    reprojection_error_px: float | None = Field(description="Median reprojection error.")
    identity: MotionIdentity
    contacts: tuple[tuple[int, int, int, int], ...] = Field(
        description="Contacts of the feet: side (0 left, 1 right), part (0 foot, 1 heel, 2 toe), first frame, frames."
    )
    gait: dict[str, Any] | None = Field(
        default=None,
        description="Figures of the person's gait, as `people[].gait` of `metrics.json`; null without gait.",
    )
    movements: tuple[dict[str, Any], ...] = Field(
        default=(),
        description="Jumps, squats, sitting down and standing up, as `people[].movements` of `metrics.json`.",
    )


class MotionPose(ResponseModel):
    """Extrinsics of a camera: `x_in_cam = rotation x_in_world + translation_m`."""

    rotation: tuple[tuple[float, ...], ...] = Field(description="Rows of the rotation matrix.")
    translation_m: tuple[float, float, float] = Field(description="Translation in metres.")


class MotionCamera(ResponseModel):
    """Camera with which the motion was computed."""

    name: str = Field(description="Name of the camera.")
    size_px: tuple[int, int] = Field(description="Width and height of the picture.")
    matrix: tuple[tuple[float, ...], ...] = Field(description="Rows of the camera matrix.")
    distortion: tuple[float, ...] = Field(description="OpenCV's distortion coefficients.")
    lens: str = Field(description="Model of the distortion: `standard` or `fisheye`.")
    cam_from_world: MotionPose
    video: str | None = Field(description="Name of the video file; null for a session of keypoints.")
    clock: tuple[tuple[float, ...], ...] = Field(
        description="Rows of frame number, time on the session's clock and time in the video, between which the times "
        "of all frames are interpolated."
    )


class MotionClock(ResponseModel):
    """Clock of a camera, measured: `session time = offset_s + rate * own time`; and how well other offsets fit."""

    camera: str = Field(description="Name of the camera.")
    offset_s: float = Field(description="Session time of the first frame.")
    sigma_s: float | None = Field(description="Largest standard deviation of the session times; null if unknown.")
    rate: float = Field(description="Rate of the clock; 1 for the first camera.")
    offsets_s: tuple[float, ...] = Field(description="Offsets that were compared, near the one that was found.")
    disagreement: tuple[float, ...] = Field(
        description="Share of the moving joints that disagree with the other cameras at each of these offsets."
    )


class MotionFloor(ResponseModel):
    """Floor: its height at x and y is `height_m + slope_x x + slope_y y`."""

    height_m: float = Field(description="Height at the world's origin in metres.")
    slope_x: float = Field(description="Rise along X.")
    slope_y: float = Field(description="Rise along Y.")


class MotionStrips(ResponseModel):
    """Heat strips of all people."""

    frames_per_bucket: int = Field(description="Number of output frames of a bucket.")
    columns: tuple[str, ...] = Field(description="Names of the columns.")
    people: tuple[str, ...] = Field(description="Base64 of a byte for each column and bucket, column after column.")


class MotionDescription(ResponseModel):
    """Description of a job's motion: people, joints, cameras, heat strips, structure of a record."""

    revision: int = Field(description="Revision of the edits that the motion shows.")
    schema_version: int = Field(description="Version of the description and of the records.")
    frame_rate_hz: float = Field(description="Rate of the output frames.")
    start_time_s: float = Field(description="Time of output frame 0 on the session's clock.")
    num_frames: int = Field(description="Number of output frames.")
    first_source_frame: int = Field(
        default=0, description="Number of output frame 0 in the source: in files of keypoints, or in the videos."
    )
    joint_names: tuple[str, ...] = Field(description="Names of the joints, in the order of the records' positions.")
    bones: tuple[tuple[str, str], ...] = Field(description="Pairs of joints, for drawing.")
    skeleton: MotionSkeleton
    angle_names: tuple[str, ...] = Field(
        default=(), description="Names of the joint angles of the records, in their order; docs/biomechanics.md."
    )
    record: MotionRecord
    people: tuple[MotionPerson, ...] = Field(description="People, in the order of their records.")
    cameras: tuple[MotionCamera, ...] = Field(description="Cameras of the session.")
    clocks: tuple[MotionClock, ...] | None = Field(
        default=None, description="Measured clocks of all cameras; null if the declared times were taken."
    )
    is_refined: bool = Field(description="Whether the cameras were refined.")
    floor: MotionFloor | None = Field(description="Floor; null if no foot was ever seen.")
    reprojection_error_px: dict[str, float | dict[str, float | None] | None] = Field(
        description="Figures of the reprojection error, as in `metrics.json`."
    )
    warnings: tuple[str, ...] = Field(description="Warnings about the take.")
    strips: MotionStrips
