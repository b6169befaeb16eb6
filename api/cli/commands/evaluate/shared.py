"""Steps and options that evaluations share."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from pipeline.capture.keypoints import KeypointSession
from pipeline.config import Method, ReconstructionConfig
from pipeline.data.cameras import Camera, FrameTimes, Refinement, Timebase
from pipeline.data.detections import Detections
from pipeline.data.people import People
from pipeline.identity.identify import identify
from pipeline.job_choices import MAX_STATURE_M, MIN_STATURE_M
from pipeline.joints import JointSet
from pipeline.stages.refinement import refine_from_bodies
from pipeline.tracking.parameters import derive_parameters

StatureOption = Annotated[
    list[float] | None,
    typer.Option(
        "--stature-m",
        min=MIN_STATURE_M,
        max=MAX_STATURE_M,
        metavar="M",
        help="Throw the extrinsics away, and find them from the people, of this stature. May be given once a person.",
    ),
]


def refined(
    cameras: tuple[Camera, ...],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    joints: JointSet,
    config: ReconstructionConfig,
) -> tuple[tuple[Camera, ...], Refinement | None]:
    """Cameras of an evaluation, refined if that is asked for, and the report."""
    if config.refine_calibration == "off":
        return cameras, None
    session = KeypointSession(cameras, times, timebase, detections, joints, {}, ())
    return refine_from_bodies(session, detections, joints, config)


def refinement_scores(refinement: Refinement | None) -> dict[str, Any]:
    """Figures of a refinement; none without a refinement."""
    if refinement is None:
        return {}
    return {
        "refined": refinement.refined,
        "refinement_before_px": refinement.error_before_px,
        "refinement_after_px": refinement.error_after_px,
        "bumped": len(refinement.bumped),
    }


def identified(
    people: People, cameras: Sequence[Camera], timebase: Timebase, joints: JointSet, method: Method
) -> People:
    """People after the global pass."""
    min_score = 0.0 if method == "clustering" else derive_parameters(cameras, timebase.frame_rate_hz).min_score
    return identify(people, cameras, joints, timebase, min_score)


def shown(value: float | None) -> str:
    """Figure of a table, ``-`` without data."""
    return "-" if value is None else f"{value:.4g}"
