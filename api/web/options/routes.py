"""Routes for a form that sends captures: the choices of a job, the installed networks, a sample capture."""

import mimetypes
from collections.abc import Collection, Mapping
from pathlib import Path as FilePath
from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Path, Response
from starlette.responses import FileResponse

from api.web.auth import RecordsDep
from api.web.contract.description import Resource, answer, file_content, problems
from api.web.dependencies import ServicesDep
from api.web.errors import ApiError
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from api.web.options import examples
from api.web.options.schemas import (
    ChoiceOut,
    DetectorOut,
    Options,
    ProfileNetworksOut,
    ProfileOut,
    PurposeOut,
    SampleFileOut,
    SampleOut,
)
from pipeline.core.options.config import (
    CHOICES,
    FILE_FORMATS,
    JOINTS,
    NETWORKS,
    PROFILES,
    JobChoices,
    JointsOfBody,
    Profile,
)
from pipeline.core.options.purposes import PURPOSES
from pipeline.core.options.rules import install_command
from pipeline.core.problems.requests import NOT_FOUND
from pipeline.core.runtime.packages import samples
from worker.store.repositories.work.workers import installed_detectors, writable_formats

router = APIRouter(prefix="/v1", tags=["jobs"])

# Seconds of a job a camera's frame, by profile and joints: docs/measurements.md, "Profiles".
_CAMERA_FRAME_S: Mapping[tuple[Profile, JointsOfBody], float] = {
    ("fast", "body"): 0.023,
    ("fast", "feet"): 0.054,
    ("balanced", "feet"): 0.063,
    ("balanced", "whole"): 0.100,
    ("accurate", "feet"): 0.151,
}

_INSTALL = "Run: multicap samples install"


@router.get(
    "/options",
    operation_id="getOptions",
    summary="Read the choices of a job",
    response_model=Options,
    responses={200: answer("Options") | {"headers": ETAG}, **NOT_MODIFIED},
)
def get_options(services: ServicesDep, _: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """List the choices of a job with their values, limits and defaults, and the networks that are installed."""
    workers = services.store.workers.all()
    installed, writable = installed_detectors(workers), writable_formats(workers)
    options = Options(
        profiles=tuple(_profile(name, installed) for name in PROFILES),
        detectors=tuple(
            DetectorOut(
                name=name,
                installed=None if installed is None else name in installed,
                install=install_command(name),
            )
            for name in NETWORKS
        ),
        choices=tuple(
            ChoiceOut.of(choice, _missing_formats(writable) if choice.name == "exports" else ())
            for choice in CHOICES.values()
        ),
        purposes=tuple(map(PurposeOut.of, PURPOSES)),
    )
    return conditional(options, if_none_match)


def _missing_formats(writable: Collection[str] | None) -> tuple[str, ...]:
    """Formats whose package a ready worker lacks; ``writable`` are those of all workers, ``None``: unknown."""
    if writable is None:
        return ()
    return tuple(name for name, form in FILE_FORMATS.items() if form.package is not None and name not in writable)


@router.get("/sample", operation_id="getSample", summary="Read the sample capture", responses={200: answer("Sample")})
def get_sample(_: RecordsDep) -> SampleOut:
    """List the files of the sample capture, a real take to try the service with."""
    paths = _sample_paths()
    return SampleOut(
        installed=bool(paths),
        install=_INSTALL,
        attribution=samples.ATTRIBUTION,
        files=tuple(
            SampleFileOut(
                name=path.name,
                media_type=_media_type(path),
                num_bytes=path.stat().st_size,
                link=f"/v1/sample/{quote(path.name)}",
            )
            for path in paths
        ),
    )


@router.get(
    "/sample/{sample_file}",
    operation_id="getSampleFile",
    summary="Download a file of the sample capture",
    response_class=Response,
    responses={
        200: {
            "description": "File of the sample capture.",
            "content": file_content(["application/octet-stream", "application/toml", "video/mp4"], "(the file)"),
        },
        **problems(404),
    },
)
def get_sample_file(
    sample_file: Annotated[str, Path(description="Name of a file of the sample capture.")], _: RecordsDep
) -> FileResponse:
    """Download a file of the sample capture."""
    found = [path for path in _sample_paths() if path.name == sample_file]
    if not found:
        raise ApiError(NOT_FOUND, "The sample capture has no such file, or is not installed.", hint=_INSTALL)
    return FileResponse(found[0], media_type=_media_type(found[0]))


def _sample_paths() -> list[FilePath]:
    """Files of the sample capture; none if it is not installed."""
    sample = samples.locate()
    return [] if sample is None else [*sample.videos.values(), sample.calibration]


def _media_type(path: FilePath) -> str:
    return mimetypes.guess_type(path.name)[0] or "application/octet-stream"


def _profile(name: Profile, installed: frozenset[str] | None) -> ProfileOut:
    return ProfileOut(
        name=name,
        default_joints=JobChoices(profile=name).detected_joints,
        joints=tuple(_profile_networks(name, joints, installed) for joints in JOINTS),
    )


def _profile_networks(profile: Profile, joints: JointsOfBody, installed: frozenset[str] | None) -> ProfileNetworksOut:
    networks = JobChoices(profile=profile, joints=joints).networks.names
    missing = [name for name in networks if name not in (installed or ())]
    return ProfileNetworksOut(
        joints=joints,
        networks=networks,
        camera_frame_s=_CAMERA_FRAME_S.get((profile, joints)),
        installed=None if installed is None else not missing,
        install=install_command(*networks),
    )


RESOURCE = Resource(router=router, answers=examples.ANSWERS)
