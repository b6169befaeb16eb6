"""`multicap evaluate mvor`: accuracy on the MVOR benchmark."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.shared import print_scores, shown
from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, shows_help
from api.cli.options import checked, with_choices
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import OnProgress

if not shows_help():
    import numpy as np

    from pipeline.capture.session import open_session
    from pipeline.core.data.detections import Detections
    from pipeline.detection.bodies import concatenate
    from pipeline.detection.entries import detection_joints
    from pipeline.run.engine.local import detect_people, reconstruct
    from pipeline.validation.evaluation.average_precision import InstantPoses, poses_at
    from pipeline.validation.evaluation.datasets import mvor
    from pipeline.validation.evaluation.datasets.mvor_scores import SCORED_JOINTS, score_joints_2d, score_mvor

_RATE_HZ = 1.0


@with_choices("profile", "detector", "method", "smoothing", "joint_centers")
def command(
    *,
    data: Annotated[
        Path, typer.Option(help="A folder with camma_mvor_2018.json, and the pictures in day1 to day4 as unpacked.")
    ],
    detections: Annotated[
        Path | None,
        typer.Option(help="2D keypoints in place of the pictures: COCO's results, JSON."),
    ] = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """The MVOR benchmark: operating room, three cameras, instants apart; errors of eight joints, recall, AP and PCK."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        config = replace(checked(chosen), force=True)
        benchmark = mvor.load_mvor(data)
        if detections is not None:
            bodies, body_scores = mvor.read_keypoints(detections, benchmark)
            take = reconstruct(mvor.keypoint_session(benchmark, bodies), config, bars.update)
            poses = poses_at(take.tracks, take.joints, SCORED_JOINTS, np.arange(len(benchmark.instants)))
        else:
            poses, bodies = _from_pictures(data, benchmark, config, bars.update)
            body_scores = {name: each.score.mean(1) for name, each in bodies.items()}
        scores = score_mvor(poses, benchmark, bodies)
        scores["pck_2d"] = score_joints_2d(bodies, body_scores, benchmark)
    if as_json:
        emit(scores)
        return
    _print(scores)


def _from_pictures(
    data: Path, benchmark: "mvor.MvorBenchmark", config: ReconstructionConfig, on_progress: OnProgress
) -> "tuple[list[InstantPoses], Mapping[str, Detections]]":
    """Poses at all instants, and detections with the numbers of the instants as frames. A day is a session."""
    poses: list[InstantPoses] = []
    bodies: list[Detections] = []
    joints = detection_joints(replace(config, method="tracking"))
    for day in mvor.load_days(data, benchmark):
        session = open_session(day.folders, benchmark.annotations, images_rate_hz=_RATE_HZ)
        take = reconstruct(session, config, on_progress)
        poses += poses_at(take.tracks, take.joints, SCORED_JOINTS, day.frames)
        detections = detect_people(session, config, on_progress)
        bodies += [mvor.at_instants(of_camera, joints, day) for of_camera in detections.values()]
    return poses, concatenate(bodies, [camera.name for camera in benchmark.cameras], len(COCO_17.names))


def _print(scores: Mapping[str, Any]) -> None:
    print_scores({name: value for name, value in scores.items() if name != "by_cameras"}, as_json=False)
    print_table(
        ("cameras", "people", "recall", *(f"{kind}, mm" for kind in scores["mpjpe_by_joint_mm"])),
        (
            (str(count), str(row["people"]), *map(shown, (row["recall"], *row["mpjpe_by_joint_mm"].values())))
            for count, row in scores["by_cameras"].items()
        ),
        "Errors by the number of cameras that detected the person",
    )
