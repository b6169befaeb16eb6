"""`multicap evaluate rendered`: accuracy on rendered captures with exact truth."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.shared import StatureOption, print_scores, refinement_scores
from api.cli.console import JsonOption, StageBars, reporting, shows_help
from api.cli.options import checked, with_choices

if not shows_help():
    from pipeline.capture.session import open_session
    from pipeline.detection.entries import detection_joints
    from pipeline.run.engine.local import detect_people, reconstruct
    from pipeline.validation.evaluation.camera_errors import without_extrinsics
    from pipeline.validation.evaluation.datasets.rendered import load_rendered, score_covered_heads, score_rendered
    from pipeline.validation.evaluation.extremity_errors import score_foot_directions


@with_choices("profile", "joints", "detector", "follow_s", "method", "smoothing", "joint_centers", "refine_calibration")
def command(
    *,
    data: Annotated[Path, typer.Option(help="A folder with videos/, calibration.toml and gt.npz.")],
    chosen: Mapping[str, Any],
    stature_m: StatureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Videos with exact truth: 12 body joints, Hungarian matching in each frame, gate 0.5 m; and headings of feet."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        truth = load_rendered(data)
        session = open_session(data / "videos", data / "calibration.toml")
        config = checked(chosen)
        errors: dict[str, float] = {}
        if stature_m:
            detections = detect_people(session, config, bars.update)
            cameras, errors = without_extrinsics(
                session.cameras, session.times, detections, detection_joints(config), stature_m
            )
            session = replace(session, cameras=cameras)
        reconstruction = reconstruct(session, replace(config, force=True), bars.update)
        scores = score_rendered(reconstruction.tracks, reconstruction.joints, reconstruction.timebase, truth)
        if truth.feet_m is not None:
            motions, timebase = reconstruction.animation.motions, reconstruction.timebase
            scores |= score_foot_directions(motions, timebase, truth.time_s, truth.feet_m)
        scores |= score_covered_heads(reconstruction, session.times, truth)
        scores |= refinement_scores(reconstruction.refinement) | errors
    print_scores(scores, as_json)
