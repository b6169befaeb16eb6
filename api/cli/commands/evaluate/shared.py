"""Steps and options that evaluations share."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from api.cli.console import emit, print_table, shows_help
from pipeline.core.joints import JointSet, without_hands
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import MAX_STATURE_M, MIN_STATURE_M

if not shows_help():
    from pipeline.core.data.cameras import Camera, FrameTimes, Refinement, Timebase
    from pipeline.core.data.detections import Detections
    from pipeline.core.data.people import People
    from pipeline.run.engine.methods import Association
    from pipeline.run.engine.recalibration import refine_from_bodies

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
    cameras: "tuple[Camera, ...]",
    times: "Mapping[str, FrameTimes]",
    detections: "Mapping[str, Detections]",
    timebase: "Timebase",
    joints: JointSet,
    config: ReconstructionConfig,
) -> "tuple[tuple[Camera, ...], Refinement | None]":
    """Cameras of an evaluation, refined if requested, and the report."""
    if config.refine_calibration == "off":
        return cameras, None
    association = Association(cameras, times, timebase, without_hands(joints), config)
    return refine_from_bodies(association, detections, joints)


def refinement_scores(refinement: "Refinement | None") -> dict[str, Any]:
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
    people: "People",
    cameras: "tuple[Camera, ...]",
    times: "Mapping[str, FrameTimes]",
    timebase: "Timebase",
    joints: JointSet,
    config: ReconstructionConfig,
) -> "People":
    """People after the global pass, with one person and one side for each limb, like the stage ``identify``."""
    association = Association(cameras, times, timebase, joints, config)
    return association.assign_limbs(association.assign_identities(people))


def print_scores(scores: Mapping[str, Any], as_json: bool) -> None:
    """Print scores as JSON, or as a table with a row for each figure of a mapping."""
    if as_json:
        emit(scores)
        return
    parts = {name: value if isinstance(value, Mapping) else {"": value} for name, value in scores.items()}
    rows = ((f"{name} {key}".strip(), shown(part)) for name, of in parts.items() for key, part in of.items())
    print_table(("measure", "value"), rows)


def shown(value: float | None) -> str:
    """Figure of a table, ``-`` without data."""
    return "-" if value is None else f"{value:.4g}"
