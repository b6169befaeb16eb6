"""Routes for a form that sends captures: the choices of a job, the installed networks, a sample capture."""

import mimetypes
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Annotated, Self
from urllib.parse import quote

from fastapi import APIRouter, Path, Response
from pydantic import Field
from starlette.responses import FileResponse

from api.web.auth import RecordsDep
from api.web.contract.description import Resource, file_content, problems
from api.web.contract.schemas import ResponseModel
from api.web.dependencies import ServicesDep
from api.web.errors import ApiError
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from pipeline.core.options import config
from pipeline.core.options.choices import Choice, Group, Kind
from pipeline.core.options.config import Preset
from pipeline.core.options.file_formats import FILE_FORMATS, Export
from pipeline.core.options.rules import install_command
from pipeline.core.problems.request_codes import NOT_FOUND
from pipeline.core.runtime.packages import samples
from pipeline.run.space import CAMERA_FRAME_S
from worker.store.repositories.work.workers import shared_by_ready


class DetectorOut(ResponseModel):
    """Detector network that can be used alone, and whether it is installed."""

    name: str = Field(description="Value of `detector` in the spec of a job.", examples=["movenet-multipose"])
    installed: bool | None = Field(examples=[True])
    """True if all ready workers have the detector; null while no worker is ready."""
    install: str = Field(examples=["Run: multicap models install movenet-multipose"])
    """Advice to the operator on the installation."""


class ProfileNetworksOut(ResponseModel):
    """Networks of a profile for some joints, and whether they are installed."""

    joints: config.JointsOfBody = Field(description="Value of `joints` in the spec of a job.")
    networks: tuple[str, ...] = Field(description="Names of the networks.", examples=[["movenet-multipose"]])
    camera_frame_s: float | None = Field(examples=[0.023])
    """Seconds that a job took for a frame of a camera when it was measured, on one core; null if it was not measured.
    Other machines are faster or slower."""
    installed: bool | None = Field(examples=[True])
    """True if all ready workers have the networks; null while no worker is ready."""
    install: str = Field(examples=["Run: multicap models install movenet-multipose"])
    """Advice to the operator on the installation."""


class ProfileOut(ResponseModel):
    """Profile: networks that find the 2D joints."""

    name: config.Profile = Field(description="Value of `profile` in the spec of a job.")
    default_joints: config.JointsOfBody = Field(description="Joints of the profile, where `joints` is `auto`.")
    joints: tuple[ProfileNetworksOut, ...] = Field(description="Networks by joints.")


class ValueOut(ResponseModel):
    """Named value of a choice."""

    name: str = Field(description="Value in the spec of a job.", examples=["tracking"])
    label: str = Field(description="Label of the value for people.", examples=["Tracking whole bodies"])
    note: str = Field(description="Further sentence, such as a measured cost; empty for none.", examples=[""])


class ChoiceOut(ResponseModel):
    """Choice of a job, as a field of a form."""

    name: str = Field(description="Name of the field in the spec of a job.", examples=["method"])
    label: str = Field(description="Heading of the field in a form.", examples=["Method"])
    description: str = Field(examples=["Method that matches detections to people."])
    """Meaning of the choice, a sentence for people."""
    group: Group = Field(examples=["advanced"])
    """Part of a form: `purpose` of the files, `people`, `quality`, or `advanced` for all else."""
    kind: Kind
    """`one` of the values, a list of `several` of them, a `flag`: true or false, a `number`, a `whole_number`, or a
    `frame_range`: a list of two whole numbers."""
    values: tuple[ValueOut, ...]
    """Named values; for numbers, the names allowed in place of a number."""
    default: bool | str | float | tuple[str, ...] | None = Field(description="Default value.", examples=["tracking"])
    unset: str | None = Field(description="Meaning of null, if null is the default.")
    minimum: float | None = Field(description="Smallest number.")
    exclusive_minimum: float | None = Field(description="Number that the value must exceed.")
    maximum: float | None = Field(description="Largest number.")

    @classmethod
    def from_choice(cls, choice: Choice, missing: Collection[str] = ()) -> Self:
        """Build the response from a choice; ``missing`` are values that are not offered, as a package is missing."""
        about = choice.about
        return cls(
            name=choice.name,
            label=about.label,
            description=about.sentence,
            group=about.group,
            kind=choice.kind,
            values=tuple(
                ValueOut(name=name, label=value.label, note=value.note)
                for name, value in choice.values.items()
                if name not in missing
            ),
            default=choice.default,
            unset=about.unset,
            minimum=about.minimum,
            exclusive_minimum=about.above,
            maximum=about.maximum,
        )


class PurposeOut(ResponseModel):
    """Purpose of a take, and the choices of a job that files for it need."""

    name: str = Field(description="Name of the purpose.", examples=["blender"])
    label: str = Field(description="Label of the purpose for people.", examples=["Blender"])
    note: str = Field(examples=["BVH and FBX in names that Blender's symmetry tools know."])
    """Sentence that tells which files it gives."""
    spec: dict[str, str | tuple[str, ...]] = Field(examples=[{"exports": ["bvh", "fbx"], "preset": "blender"}])
    """Fields of the spec of a job, with their values."""


class Options(ResponseModel):
    """Choices of a job, profiles and detector networks."""

    profiles: tuple[ProfileOut, ...] = Field(description="All profiles, with their networks.")

    detectors: tuple[DetectorOut, ...] = Field(description="All detectors that the service supports.")
    choices: tuple[ChoiceOut, ...]
    """All choices of a job, for a form. `callback_url` and `character` are not listed."""
    purposes: tuple[PurposeOut, ...]
    """Purposes of a take, for a form; each sets the same choices, the first one to their defaults."""


class SampleFileOut(ResponseModel):
    """File of the sample capture."""

    name: str = Field(description="Name of the file.", examples=["cam01.mp4"])
    media_type: str = Field(description="Content type of the file.", examples=["video/mp4"])
    num_bytes: int = Field(description="Size of the file.", examples=[950_272])
    url: str = Field(description="Path of the file.", examples=["/v1/sample/cam01.mp4"])


class SampleOut(ResponseModel):
    """Sample capture: a real take to try the service with."""

    installed: bool = Field(description="Whether the machine of the web API has the sample capture.", examples=[True])
    install: str = Field(examples=["Run: multicap samples install"])
    """Advice to the operator on the installation."""
    attribution: str = Field(examples=["Sample capture: demo of several people of Pose2Sim."])
    """Source and licence, to show with the capture."""
    files: tuple[SampleFileOut, ...] = Field(description="Videos and calibration; none if it is not installed.")


router = APIRouter(prefix="/v1", tags=["jobs"])

_INSTALL = "Run: multicap samples install"


@router.get(
    "/options",
    summary="Read the choices of a job",
    response_model=Options,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED},
)
def get_options(services: ServicesDep, _: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """List the choices of a job with their values, limits and defaults, and the networks that are installed."""
    workers = services.store.workers.all()
    installed, writable = shared_by_ready(workers, "detectors"), shared_by_ready(workers, "formats")
    # Formats whose package a ready worker lacks.
    packed = (name for name, form in FILE_FORMATS.items() if form.package is not None)
    missing = [] if writable is None else [name for name in packed if name not in writable]
    options = Options(
        profiles=tuple(
            ProfileOut(
                name=name,
                default_joints=config.JobChoices(profile=name).detected_joints,
                joints=tuple(_profile_networks(name, joints, installed) for joints in config.JOINTS),
            )
            for name in config.PROFILES
        ),
        detectors=tuple(
            DetectorOut(
                name=name, installed=None if installed is None else name in installed, install=install_command(name)
            )
            for name in config.NETWORKS
        ),
        choices=tuple(
            ChoiceOut.from_choice(choice, missing if choice.name == "exports" else ())
            for choice in config.CHOICES.values()
        ),
        purposes=tuple(map(PurposeOut.from_record, PURPOSES)),
    )
    return conditional(options, if_none_match)


@router.get("/sample", summary="Read the sample capture")
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
                url=f"/v1/sample/{quote(path.name)}",
            )
            for path in paths
        ),
    )


@router.get(
    "/sample/{sample_file}",
    summary="Download a file of the sample capture",
    response_class=Response,
    responses={
        200: {
            "description": "File of the sample capture.",
            "content": file_content(["application/octet-stream", "application/toml", "video/mp4"]),
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


def _profile_networks(
    profile: config.Profile, joints: config.JointsOfBody, installed: frozenset[str] | None
) -> ProfileNetworksOut:
    networks = config.JobChoices(profile=profile, joints=joints).networks.names
    missing = [name for name in networks if name not in (installed or ())]
    return ProfileNetworksOut(
        joints=joints,
        networks=networks,
        camera_frame_s=CAMERA_FRAME_S.get((profile, joints)),
        installed=None if installed is None else not missing,
        install=install_command(*networks),
    )


@dataclass(frozen=True, slots=True)
class Purpose:
    """Purpose of a take: choices of a job that files for it need."""

    name: str
    label: str  # Name in forms and documentation
    note: str  # Sentence that tells which files it gives
    exports: tuple[Export, ...]
    preset: Preset = "default"

    @property
    def spec(self) -> dict[str, str | tuple[str, ...]]:
        """Choices of a job's spec that the purpose sets."""
        return {"exports": self.exports, "preset": self.preset}


PURPOSES = (
    Purpose("motion", "Any software", "BVH in standard names, which most software reads.", ("bvh",)),
    Purpose(
        "blender", "Blender", "BVH and FBX in names that Blender's symmetry tools know.", ("bvh", "fbx"), "blender"
    ),
    Purpose(
        "unreal",
        "Unreal Engine",
        "FBX and BVH in the names of the mannequin and of MetaHuman.",
        ("bvh", "fbx"),
        "unreal",
    ),
    Purpose("unity", "Unity", "FBX that Unity maps to a humanoid, and BVH.", ("bvh", "fbx"), "unity-humanoid"),
    Purpose(
        "maya",
        "Maya, MotionBuilder",
        "FBX that HumanIK characterises by its names, and BVH.",
        ("bvh", "fbx"),
        "humanik",
    ),
    Purpose(
        "character",
        "My own character",
        "GLB, FBX and BVH of your character, beside the files of each person.",
        ("bvh", "glb", "fbx"),
    ),
    Purpose("vrm", "VRM characters", "VRMA, which every VRM character plays.", ("vrma",)),
    Purpose("web", "Web pages", "GLB with bodies and cameras, for three.js, Babylon.js and model viewers.", ("glb",)),
    Purpose(
        "research",
        "Biomechanics",
        "Joint positions as TRC, C3D and CSV; joint angles as CSV and MOT.",
        ("trc", "c3d", "csv", "angles", "mot"),
    ),
)
"""Purposes in the order of the form. The first one has the defaults."""


RESOURCE = Resource(router=router)
