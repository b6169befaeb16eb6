"""Routes for viewers: what a job's motion consists of, and ranges of its frames."""

import contextlib
import json
import struct
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, BinaryIO

from fastapi import APIRouter, Header, Query, Response

from api.web.auth import JobViewDep
from api.web.contract.description import Resource, answer, file_content, problems
from api.web.dependencies import JobId, Services, ServicesDep
from api.web.downloads import Download, Stream, opened
from api.web.errors import ApiError
from api.web.http.conditional import ETAG, NOT_MODIFIED, ByteRange, IfNoneMatch, matches, select_range
from api.web.motion import examples
from api.web.motion.schemas import MotionDescription
from pipeline.core.problems.requests import CONFLICT, NOT_FOUND
from pipeline.run.engine.stage import DESCRIPTION, MOTION
from worker.store.model.jobs import Result
from worker.store.tenant_records import TenantRecords

router = APIRouter(prefix="/v1/jobs/{job_id}/motion", tags=["results"])

MEDIA_TYPE = "application/vnd.multicap.motion"
_BLOCK_BYTES = 2**18
_CONTENT = file_content([MEDIA_TYPE], "(16 bytes for each person, then the records of the person's frames)")
_HEADERS = {**ETAG, "Accept-Ranges": {"schema": {"type": "string", "const": "bytes"}}}


@dataclass(frozen=True, slots=True)
class _Person:
    """Place of a person's records in ``motion.bin``."""

    id: int
    start_frame: int
    num_frames: int
    offset_bytes: int


@dataclass(frozen=True, slots=True)
class _Index:
    """Places of all records in ``motion.bin``."""

    num_frames: int
    record_bytes: int
    people: tuple[_Person, ...]


@dataclass(frozen=True, slots=True)
class _Part:
    """Part of an answer: the head of a person's records, or bytes of ``motion.bin`` from ``start`` on."""

    num_bytes: int
    head: bytes | None = None
    start: int = 0


@router.get(
    "/description",
    operation_id="getMotionDescription",
    summary="Describe a job's motion",
    response_model=MotionDescription,
    responses={200: answer("MotionDescription") | {"headers": ETAG}, **NOT_MODIFIED, **problems(404, 409, 410)},
)
def get_motion_description(
    job_id: JobId, services: ServicesDep, records: JobViewDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Describe a job's motion: people, joints, cameras, heat strips, and the structure of a frame's record."""
    (result,) = _results(records, job_id, DESCRIPTION)
    headers = _headers(f'"{result.sha256}.{result.revision}"')
    with opened(services, Download.of(result)) as file:
        if matches(if_none_match, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        # Equal edits have equal files, whatever their revision is: it is put in front of the file's first field.
        content = b'{"revision":%d,' % result.revision + file.read().removeprefix(b"{")
        return Response(content, headers=headers, media_type="application/json")


@router.get(
    "",
    operation_id="getMotion",
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
    bytes of a record. People without frames in the range are left out. docs/formats.md describes the records.
    """
    description, result = _results(records, job_id, DESCRIPTION, MOTION)
    if revision is not None and revision != result.revision:
        message = f"The motion is of the revision {result.revision} now, not {revision}."
        raise ApiError(CONFLICT, message, hint="Read the description of the motion again.")
    index = _read_index(services, description)
    last = index.num_frames if stop is None else min(stop, index.num_frames)
    wanted = None if person is None else frozenset(person)
    parts = list(_parts(index, range(first, max(first, last)), wanted))
    num_bytes = sum(part.num_bytes for part in parts)
    people = "all" if wanted is None else "-".join(map(str, sorted(wanted)))
    headers = _headers(f'"{result.sha256}.{first}.{last}.{people}"') | {"Accept-Ranges": "bytes"}
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(opened(services, Download.of(result)))
        if matches(if_none_match, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        sent, status, sizes = select_range(range_, num_bytes, "answer")
        stack.pop_all()
    content = _content(file, parts, sent)
    return Stream(content, status, headers=headers | sizes, media_type=MEDIA_TYPE, file=file)


def _results(records: TenantRecords, job_id: str, *names: str) -> list[Result]:
    """Files of a job, all of one revision."""
    results = {result.name: result for result in records.results.all(job_id)}
    try:
        return [results[name] for name in names]
    except KeyError:
        message = "The job has no motion to look at."
        hint = "Start another job of its session, if it is a reconstruction: older versions wrote no such files."
        raise ApiError(NOT_FOUND, message, hint=hint) from None


def _headers(etag: str) -> dict[str, str]:
    return {"ETag": etag, "Cache-Control": "private, no-cache"}


def _read_index(services: Services, description: Result) -> _Index:
    with opened(services, Download.of(description)) as file:
        document = json.load(file)
    people = tuple(
        _Person(person["id"], person["start_frame"], person["num_frames"], person["offset_bytes"])
        for person in document["people"]
    )
    return _Index(document["num_frames"], document["record"]["num_bytes"], people)


def _parts(index: _Index, frames: range, wanted: frozenset[int] | None) -> Iterator[_Part]:
    """Parts of the answer, in the order of ``motion.bin``."""
    for person in index.people:
        first = max(frames.start, person.start_frame)
        num_frames = min(frames.stop, person.start_frame + person.num_frames) - first
        if num_frames > 0 and (wanted is None or person.id in wanted):
            head = struct.pack("<4I", person.id, first, num_frames, index.record_bytes)
            yield _Part(len(head), head)
            start = person.offset_bytes + (first - person.start_frame) * index.record_bytes
            yield _Part(num_frames * index.record_bytes, start=start)


def _content(file: BinaryIO, parts: Sequence[_Part], sent: ByteRange) -> Generator[bytes, None, None]:
    """Bytes of a range of the answer, block by block."""
    with file:
        place = 0
        for part in parts:
            first, stop = max(sent.start - place, 0), min(sent.stop - place, part.num_bytes)
            place += part.num_bytes
            if first >= stop:
                continue
            if part.head is not None:
                yield part.head[first:stop]
                continue
            file.seek(part.start + first)
            left = stop - first
            while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
                left -= len(block)
                yield block


RESOURCE = Resource(router=router, answers=examples.ANSWERS)
