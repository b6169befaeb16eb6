"""Routes for viewers: what a job's motion consists of, and ranges of its frames."""

import contextlib
import json
import struct
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, BinaryIO

from fastapi import APIRouter, Header, Query, Response
from pydantic import Field

from api.web.auth import JobViewDep
from api.web.contract.description import Resource, file_content, problems
from api.web.contract.schemas import FindingOut, ResponseModel
from api.web.dependencies import JobId, ServicesDep
from api.web.downloads import Download, Stream, opened, read_blocks
from api.web.errors import ApiError
from api.web.http.conditional import ETAG, NOT_MODIFIED, ByteRange, IfNoneMatch, matches, select_range
from pipeline.core.problems.request_codes import CONFLICT, NOT_FOUND
from pipeline.run.engine.stage import DESCRIPTION, DETECT, MOTION
from worker.store.errors import NotFound
from worker.store.files.artifacts import read_artifact
from worker.store.files.file_keys import first_people_key
from worker.store.model.job_records import Result
from worker.store.tenant_records import TenantRecords


class MotionSkeleton(ResponseModel):
    """Joints of the animation skeleton."""

    names: tuple[str, ...] = Field(examples=[["Hips", "Spine"]])
    """Names of the joints, in the order of the records' positions."""
    parents: tuple[int | None, ...] = Field(examples=[[None, 0]])
    """Number of each joint's parent; null of the root."""


class MotionRecord(ResponseModel):
    """Structure of the record of a frame."""

    num_bytes: int = Field(description="Size of a record.", examples=[48])
    offsets: dict[str, int] = Field(examples=[{"origin_m": 0, "joints": 12, "skeleton": 24}])
    """First byte of each field; `/help/file-contents` describes the fields."""
    absent: int = Field(examples=[-32_768])
    """Coordinate of a joint without a position, and number of an angle that is unknown."""
    angle_step_deg: float | None = None
    """Step of quantised joint angles; null of results that have none."""
    error_step_px: float = Field(description="Step of quantised reprojection errors.", examples=[0.5])
    unknown_error: int = Field(description="Value of an error that is not known.", examples=[255])


class MotionDoubt(ResponseModel):
    """Moment at which a person may have been taken for another one."""

    frame: int = Field(description="Output frame from which on the other choice differs.")
    confidence: float = Field(description="Probability of the choice.")
    other: int | None = Field(description="Person that would continue as this one; null if there is no other.")


class MotionIdentity(ResponseModel):
    """Confidence in a person's identity."""

    confidence: float = Field(description="Probability that the person is one and the same all the time.")
    doubts: tuple[MotionDoubt, ...] = Field(description="Doubtful moments.", examples=[[]])


class MotionPerson(ResponseModel):
    """Person of the motion."""

    id: int = Field(description="Number of the person.")
    name: str = Field(description="Name of the person, as in the names of result files.", examples=["person-1"])
    color: str = Field(description="Colour of the person in pictures and models, `#rrggbb`.", examples=["#2626ff"])
    start_frame: int = Field(description="First output frame.", examples=[0])
    num_frames: int = Field(description="Number of frames.", examples=[300])
    offset_bytes: int = Field(description="First byte of the person's records, without heads.", examples=[0])
    position_step_m: float = Field(description="Step of quantised positions.", examples=[0.0001])
    coverage: float | None = Field(description="Share of measured joints.", examples=[1.0])
    stature_m: float | None = Field(description="Estimated stature.", examples=[1.78])
    reprojection_error_px: float | None = Field(description="Median reprojection error.", examples=[3.1])
    identity: MotionIdentity
    contacts: tuple[tuple[int, int, int, int], ...] = Field(examples=[[[0, 0, 1, 2]]])
    """Contacts of the feet: side (0 left, 1 right), part (0 foot, 1 heel, 2 toe), first frame, frames."""
    gait: dict[str, Any] | None = None
    """Figures of the person's gait, as `people[].gait` of `metrics.json`; null without gait."""
    movements: tuple[dict[str, Any], ...] = ()
    """Jumps, squats, sitting down and standing up, as `people[].movements` of `metrics.json`."""
    mass_weights: tuple[float, ...] | None = None
    """Weights of the joints in the centre of mass; null if joints of the body are missing."""


class MotionPose(ResponseModel):
    """Extrinsics of a camera: `x_in_cam = rotation x_in_world + translation_m`."""

    rotation: tuple[tuple[float, ...], ...] = Field(examples=[[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]])
    """Rows of the rotation matrix."""
    translation_m: tuple[float, float, float] = Field(description="Translation in metres.", examples=[[0.0, 1.2, 4.0]])


class MotionCamera(ResponseModel):
    """Camera with which the motion was computed."""

    name: str = Field(description="Name of the camera.", examples=["cam_0"])
    size_px: tuple[int, int] = Field(description="Width and height of the picture.", examples=[[1920, 1080]])
    matrix: tuple[tuple[float, ...], ...] = Field(
        description="Rows of the camera matrix.",
        examples=[[[1500.0, 0.0, 959.5], [0.0, 1500.0, 539.5], [0.0, 0.0, 1.0]]],
    )
    distortion: tuple[float, ...] = Field(examples=[[-0.1, 0.02, 0.0, 0.0]])
    """OpenCV's distortion coefficients."""
    lens: str = Field(description="Model of the distortion: `standard` or `fisheye`.", examples=["standard"])
    cam_from_world: MotionPose
    video: str | None = Field(examples=["cam_0.mp4"])
    """Name of the video file; null for a session of keypoints."""
    clock: tuple[tuple[float, ...], ...] = Field(examples=[[[0, 0.0, 0.0], [2, 0.08, 0.08]]])
    """Rows of frame number, time on the session's clock and time in the video, between which the times of all frames
    are interpolated."""


class MotionClock(ResponseModel):
    """Clock of a camera, measured: `session time = offset_s + rate * own time`; and how well other offsets fit."""

    camera: str = Field(description="Name of the camera.")
    offset_s: float = Field(description="Session time of the first frame.")
    sigma_s: float | None = Field(description="Largest standard deviation of the session times; null if unknown.")
    rate: float = Field(description="Rate of the clock; 1 for the first camera.")
    offsets_s: tuple[float, ...] = Field(description="Offsets that were compared, near the one that was found.")
    disagreement: tuple[float, ...]
    """Share of the moving joints that disagree with the other cameras at each of these offsets."""


class MotionFloor(ResponseModel):
    """Floor: its height at x and y is `height_m + slope_x x + slope_y y`."""

    height_m: float = Field(description="Height at the world's origin in metres.")
    slope_x: float = Field(description="Rise along X.")
    slope_y: float = Field(description="Rise along Y.")


class MotionPoint(ResponseModel):
    """Point of the user's own: of a person, or of an object."""

    name: str = Field(description="Name of the point.", examples=["racket_tip"])
    person: int | None = Field(description="Number of the person; null for an object.")
    start_frame: int = Field(description="Output frame of the first position.")
    origin_m: tuple[float, float, float] = Field(description="World position that positions are relative to.")
    position_step_m: float = Field(description="Unit of the positions in metres.")
    positions: str = Field(examples=["AAAAAAAA"])
    """Base64 of three int16 for each frame, little-endian; -32768: unknown."""


class MotionStrips(ResponseModel):
    """Heat strips of all people."""

    frames_per_bucket: int = Field(description="Number of output frames of a bucket.")
    columns: tuple[str, ...] = Field(description="Names of the columns.", examples=[["measured", "interpolated"]])
    people: tuple[str, ...] = Field(examples=[["////AAAA"]])
    """Base64 of a byte for each column and bucket, column after column."""


class MotionDescription(ResponseModel):
    """Description of a job's motion: people, joints, cameras, heat strips, structure of a record."""

    revision: int = Field(description="Revision of the edits that the motion shows.", examples=[0])
    schema_version: int = Field(description="Version of the description and of the records.")
    frame_rate_hz: float = Field(description="Rate of the output frames.", examples=[25.0])
    start_time_s: float = Field(description="Time of output frame 0 on the session's clock.", examples=[0.0])
    num_frames: int = Field(description="Number of output frames.", examples=[300])
    first_source_frame: int = 0
    """Number of output frame 0 in the source: in files of keypoints, or in the videos."""
    joint_names: tuple[str, ...] = Field(examples=[["nose", "left_eye"]])
    """Names of the joints, in the order of the records' positions."""
    bones: tuple[tuple[str, str], ...] = Field(examples=[[["nose", "left_eye"]]])
    """Pairs of joints, for drawing."""
    skeleton: MotionSkeleton
    angle_names: tuple[str, ...] = ()
    """Names of the joint angles of the records, in their order; see `/help/biomechanics`."""
    record: MotionRecord
    people: tuple[MotionPerson, ...] = Field(description="People, in the order of their records.")
    points: tuple[MotionPoint, ...] = Field(default=(), description="Points of the user's own; see `/help/own-points`.")
    point_bones: tuple[tuple[int, int], ...] = Field(default=(), examples=[[[0, 1]]])
    """Pairs of places in `points` between which bones are."""
    cameras: tuple[MotionCamera, ...] = Field(description="Cameras of the session.")
    clocks: tuple[MotionClock, ...] | None = None
    """Measured clocks of all cameras; null if the declared times were taken."""
    is_refined: bool = Field(description="Whether the cameras were refined.")
    floor: MotionFloor | None = Field(description="Floor; null if no foot was ever seen.")
    reprojection_error_px: dict[str, float | dict[str, float | None] | None] = Field(
        description="Figures of the reprojection error, as in `metrics.json`.",
        examples=[{"median": 3.1, "by_camera": {"cam_0": 3.1}}],
    )
    warnings: tuple[FindingOut, ...] = Field(description="Warnings about the take.")
    strips: MotionStrips


router = APIRouter(prefix="/v1/jobs/{job_id}/motion", tags=["results"])

MEDIA_TYPE = "application/vnd.multicap.motion"
_CONTENT = file_content([MEDIA_TYPE])
_HEADERS = {**ETAG, "Accept-Ranges": {"schema": {"type": "string", "const": "bytes"}}}


@dataclass(frozen=True, slots=True)
class _Part:
    """Part of an answer: the head of a person's records, or bytes of ``motion.bin`` from ``start`` on."""

    num_bytes: int
    head: bytes | None = None
    start: int = 0


_MAX_RANGES = 20  # of an answer


class FirstPeopleOut(ResponseModel):
    """People who were located before they are tracked, while a job runs."""

    ranges: tuple[dict[str, Any], ...]
    """Ranges of frames in order: `instants`, each with `time_s` and `people`; `joints`, `bones` and `parents` of the
    skeleton; and `rig`, the cameras. A person has an `id` within the range, and `joints_m`: the places of the joints,
    null where one is unknown."""
    next: int = Field(description="Number of the next range, to ask for later.", examples=[3])


@router.get(
    "/first-people",
    summary="Look at the first people of a running job",
    response_model=FirstPeopleOut,
    responses=problems(404, 422),
)
def get_first_people(
    job_id: JobId,
    services: ServicesDep,
    records: JobViewDep,
    first: Annotated[int, Query(alias="from", ge=0, description="Number of the first range, from 0.")] = 0,
) -> Response:
    """List people of the ranges of frames in which all cameras' detections are done, a few ranges at a time.

    They are located at a few instants, not tracked, and gone when the job has ended.
    """
    job = records.jobs.get(job_id)
    num_cameras = max(1, len(records.sessions.get(job.session_id).preflight.cameras))  # 3D points have no camera
    outputs = services.store.outputs.list_stage(job_id, DETECT)[first * num_cameras :]
    found, number = list[bytes](), 0
    while number < min(_MAX_RANGES, len(outputs) // num_cameras):
        cameras = outputs[number * num_cameras : (number + 1) * num_cameras]
        if any(output.sha256 is None for output in cameras):
            break
        number += 1
        for output in cameras:
            with contextlib.suppress(NotFound):
                found.append(read_artifact(services.artifacts, first_people_key(job_id, job.attempt, output.key), None))
    return Response(b'{"ranges":[%s],"next":%d}' % (b",".join(found), first + number), media_type="application/json")


@router.get(
    "/description",
    summary="Describe a job's motion",
    response_model=MotionDescription,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404, 409, 410)},
)
def get_motion_description(
    job_id: JobId, services: ServicesDep, records: JobViewDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Describe a job's motion: people, joints, cameras, heat strips, and the structure of a frame's record."""
    (result,) = _results(records, job_id, DESCRIPTION)
    headers = _headers(f'"{result.sha256}.{result.revision}"')
    with opened(services, Download.from_result(result)) as file:
        if matches(if_none_match, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        # Equal edits have equal files, whatever their revision is: it is put in front of the file's first field.
        content = b'{"revision":%d,' % result.revision + file.read().removeprefix(b"{")
        return Response(content, headers=headers, media_type="application/json")


@router.get(
    "",
    summary="Read frames of a job's motion",
    response_class=Response,
    responses={
        200: {"description": "Records of all frames asked for.", "content": _CONTENT, "headers": _HEADERS},
        206: {"description": "Range of these bytes.", "content": _CONTENT, "headers": _HEADERS},
        **NOT_MODIFIED,
        **problems(404, 409, 410, 416, 422),
    },
)
def get_motion(
    job_id: JobId,
    services: ServicesDep,
    records: JobViewDep,
    first: Annotated[int, Query(alias="from", ge=0, description="First output frame.")] = 0,
    stop: Annotated[
        int | None, Query(alias="to", ge=0, description="Frame after the last one; without it all.")
    ] = None,
    person: Annotated[
        Sequence[int] | None, Query(max_length=1000, description="Ids of people; without it all people.")
    ] = None,
    revision: Annotated[
        int | None, Query(ge=0, description="Revision of the description at hand; 409 if the motion is of another one.")
    ] = None,
    range_: Annotated[str | None, Header(alias="Range", description="A single range of bytes.")] = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Read frames of a job's motion: for each person a head of 16 bytes and a record for each frame.

    The head holds four little-endian 32-bit numbers: the person's id, the first frame, the number of frames and the
    bytes of a record. People without frames in the range are left out. `/help/file-contents` describes the records.
    """
    description, result = _results(records, job_id, DESCRIPTION, MOTION)
    if revision is not None and revision != result.revision:
        message = f"The motion is of the revision {result.revision} now, not {revision}."
        raise ApiError(CONFLICT, message, hint="Read the description of the motion again.")
    with opened(services, Download.from_result(description)) as described:
        index = json.load(described)
    last = index["num_frames"] if stop is None else min(stop, index["num_frames"])
    wanted = None if person is None else frozenset(person)
    parts = list(_parts(index, range(first, max(first, last)), wanted))
    num_bytes = sum(part.num_bytes for part in parts)
    people = "all" if wanted is None else "-".join(map(str, sorted(wanted)))
    headers = _headers(f'"{result.sha256}.{first}.{last}.{people}"') | {"Accept-Ranges": "bytes"}
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(opened(services, Download.from_result(result)))
        if matches(if_none_match, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        sent, status, sizes = select_range(range_, num_bytes, "answer")
        stack.pop_all()
    content = _content(file, parts, sent)
    return Stream(content, status, headers=headers | sizes, media_type=MEDIA_TYPE, file=file)


def _results(records: TenantRecords, job_id: str, *names: str) -> list[Result]:
    results = {result.name: result for result in records.results.all(job_id)}
    try:
        return [results[name] for name in names]
    except KeyError:
        message = "The job has no motion to look at."
        hint = "Start another job of its capture, if it is a reconstruction: older versions wrote no such files."
        raise ApiError(NOT_FOUND, message, hint=hint) from None


def _headers(etag: str) -> dict[str, str]:
    return {"ETag": etag, "Cache-Control": "private, no-cache"}


def _parts(index: Mapping[str, Any], frames: range, wanted: frozenset[int] | None) -> Iterator[_Part]:
    """Parts of the answer, in the order of ``motion.bin``; ``index`` is the description of the motion."""
    record_bytes = index["record"]["num_bytes"]
    for person in index["people"]:
        number, start_frame = person["id"], person["start_frame"]
        first = max(frames.start, start_frame)
        num_frames = min(frames.stop, start_frame + person["num_frames"]) - first
        if num_frames > 0 and (wanted is None or number in wanted):
            head = struct.pack("<4I", number, first, num_frames, record_bytes)
            yield _Part(len(head), head)
            yield _Part(num_frames * record_bytes, start=person["offset_bytes"] + (first - start_frame) * record_bytes)


def _content(file: BinaryIO, parts: Sequence[_Part], sent: ByteRange) -> Generator[bytes, None, None]:
    with file:
        place = 0
        for part in parts:
            first, stop = max(sent.start - place, 0), min(sent.stop - place, part.num_bytes)
            place += part.num_bytes
            if first >= stop:
                continue
            if part.head is not None:
                yield part.head[first:stop]
            else:
                yield from read_blocks(file, ByteRange(part.start + first, part.start + stop))


RESOURCE = Resource(router=router)
