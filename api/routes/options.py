"""Route of options: the choices of a job, and the installed networks."""

from fastapi import APIRouter, Response

from api.auth import RecordsDep
from api.contract.description import answer
from api.dependencies import ServicesDep
from api.http.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from api.schemas.options import ChoiceOut, DetectorOut, Options, ProfileNetworksOut, ProfileOut
from pipeline.config import (
    CHOICES,
    JOINTS,
    NETWORKS,
    PROFILES,
    JobChoices,
    JointsOfBody,
    Profile,
    detected_joints,
    install_command,
    networks_of,
)
from worker.jobs.repositories.work.workers import installed_detectors

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.get(
    "/options",
    operation_id="getOptions",
    summary="Read the choices of a job",
    response_model=Options,
    responses={200: answer("Options") | {"headers": ETAG}, **NOT_MODIFIED},
)
def get_options(services: ServicesDep, _: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """List the choices of a job with their values, limits and defaults, and the networks that are installed."""
    installed = installed_detectors(services.store.workers.all())
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
        choices=tuple(ChoiceOut.of(choice) for choice in CHOICES.values()),
    )
    return conditional(options, if_none_match)


def _profile(name: Profile, installed: frozenset[str] | None) -> ProfileOut:
    return ProfileOut(
        name=name,
        default_joints=detected_joints(JobChoices(profile=name)),
        joints=tuple(_profile_networks(name, joints, installed) for joints in JOINTS),
    )


def _profile_networks(profile: Profile, joints: JointsOfBody, installed: frozenset[str] | None) -> ProfileNetworksOut:
    networks = networks_of(JobChoices(profile=profile, joints=joints)).names
    missing = [name for name in networks if name not in (installed or ())]
    return ProfileNetworksOut(
        joints=joints,
        networks=networks,
        installed=None if installed is None else not missing,
        install=install_command(*networks),
    )
