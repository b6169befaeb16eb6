"""`multicap evaluate shelf`: accuracy on the Shelf benchmark."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.actors import evaluate_actors, print_actors
from api.cli.commands.evaluate.shared import StatureOption, identified, refined, refinement_scores
from api.cli.console import JsonOption, emit, print_table, reporting, shows_help
from api.cli.options import KeypointsOption, checked, with_choices
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.joints import COCO_17
from pipeline.core.problems.finding_codes import NO_ABLATION, SOURCES

if not shows_help():
    from pipeline.association.clustering.cluster_people import reconstruct_by_clustering
    from pipeline.association.clustering.clustering_parameters import derive_parameters as clustering_parameters
    from pipeline.association.tracking.track_people import assign_detections, locate_people
    from pipeline.association.tracking.tracking_parameters import derive_parameters
    from pipeline.core.data.people import People
    from pipeline.export.quality.report import bone_length_std_cm, mean_jitter_m_s2
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.evaluation.baselines import live_tracks
    from pipeline.validation.evaluation.camera_errors import without_extrinsics
    from pipeline.validation.evaluation.datasets.shelf import DEFAULT_DETECTIONS, load_shelf, score_shelf, thin
    from pipeline.validation.evaluation.datasets.shelf_tracking import ablate, association_accuracy, score_tracking


@with_choices("profile", "detector", "method", "smoothing", "joint_centers", "refine_calibration")
def command(
    *,
    data: Annotated[
        Path,
        typer.Option(
            help="The published folder: actorsGT.mat, a calibration, and Camera0, Camera1, ... or detections_*.npz."
        ),
    ],
    keypoints: KeypointsOption = None,
    chosen: Mapping[str, Any],
    stature_m: StatureOption = None,
    detections: Annotated[Path | None, typer.Option(help="File of other 2D keypoints of the same images.")] = None,
    every: Annotated[
        int, typer.Option(min=1, max=10, help="Keep every n-th image, at a different phase for each camera.")
    ] = 1,
    ablation: Annotated[
        bool, typer.Option(help="Also measure the contribution of each part of the method (half a minute).")
    ] = False,
    live: Annotated[
        bool, typer.Option(help="Also score a live capture of the same keypoints, which knows no later images.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """The Shelf benchmark: PCP of images 300-599, mean over actors 1-3, in percent."""
    with reporting(as_json):
        config = checked(chosen)
        if keypoints or not (detections or (data / DEFAULT_DETECTIONS).exists()):
            given = {"--detections": detections, "--every": every > 1, "--ablation": ablation, "--live": live}
            if names := [name for name, value in {**given, "--stature-m": stature_m}.items() if value]:
                message = f"{listed_names(names)} need the keypoints of all images in one file, {DEFAULT_DETECTIONS}."
                raise InputError([Problem(SOURCES, message, hint="Omit them, or give such a file by --detections.")])
            evaluate_actors("shelf", data, keypoints, config, as_json)
            return
        whole = load_shelf(data, detections)
        if ablation and config.method != "tracking":
            raise InputError([Problem(NO_ABLATION, f"'{config.method}' has no ablation.", hint="Omit --ablation.")])
        benchmark, kept = thin(whole, every)
        warm_up()
        started_s = time.perf_counter()
        errors: dict[str, float] = {}
        if stature_m:
            cameras, errors = without_extrinsics(
                benchmark.cameras, benchmark.times, benchmark.detections, COCO_17, stature_m
            )
            benchmark = replace(benchmark, cameras=cameras)
        cameras, refinement = refined(
            benchmark.cameras, benchmark.times, benchmark.detections, benchmark.timebase, COCO_17, config
        )
        benchmark = replace(benchmark, cameras=cameras)
        views = (benchmark.cameras, benchmark.times, benchmark.detections)
        identities = None
        if config.method == "clustering":
            parameters = clustering_parameters(benchmark.cameras)
            people = People(*reconstruct_by_clustering(*views, benchmark.timebase, COCO_17, parameters))
        else:
            limits = derive_parameters(benchmark.cameras, benchmark.timebase.frame_rate_hz)
            identities = assign_detections(*views, limits)
            people = locate_people(*views, identities, benchmark.timebase, limits)
        people = identified(people, benchmark.cameras, benchmark.times, benchmark.timebase, COCO_17, config)
        tracks = animate(
            people.tracks, people.observations, benchmark.cameras, benchmark.timebase, COCO_17, config
        ).tracks
        elapsed_s = time.perf_counter() - started_s
        result = {
            "method": config.method,
            **score_shelf(tracks, benchmark),
            # Clustering assigns joints to people, not whole detections.
            "association_accuracy": None if identities is None else association_accuracy(identities, kept)["all"],
            **score_tracking(tracks, benchmark),
            "bone_std_cm": bone_length_std_cm(tracks, COCO_17),
            "jitter_m_s2": mean_jitter_m_s2(tracks, benchmark.timebase.frame_rate_hz),
            "fps": benchmark.timebase.num_frames / elapsed_s,
            **refinement_scores(refinement),
            **errors,
        }
        if live:
            tracks_live = live_tracks(*views, benchmark.timebase, COCO_17)
            result["live"] = {"people": len(tracks_live), **score_shelf(tracks_live, benchmark)}
        if ablation:
            result["ablation"] = ablate(whole)
    if as_json:
        emit(result)
        return
    _print(result)


def _print(result: Mapping[str, Any]) -> None:
    print_actors(result)
    if result["association_accuracy"] is not None:
        typer.echo(f"Association accuracy {result['association_accuracy']:.4f}")
    typer.echo(
        f"Ghost tracks {result['ghost_tracks']}, standard deviation of bone lengths {result['bone_std_cm']:.2f} cm, "
        f"{result['fps']:.0f} frames a second"
    )
    print_table(
        ("camera", "MOTA", "IDF1", "false positives", "missed"),
        (
            [
                name,
                *(f"{result[metric][name]:.4f}" for metric in ("mota", "idf1")),
                *(str(result[metric][name]) for metric in ("false_positives", "missed")),
            ]
            for name in result["mota"]
        ),
    )
    typer.echo("Actors are annotated in some images only: unmatched tracks count as false near an annotated actor.")
    if found := result.get("live"):
        actors = ", ".join(f"{value:.2f}" for value in found["pcp"]["actors"])
        people = f"{found['people']} people, identity switches {found['switches']}"
        typer.echo(f"Live: average PCP {found['pcp']['average']:.2f} % ({actors}), {people}")
    if ablation := result.get("ablation"):
        _print_ablation(ablation)


def _print_ablation(ablation: dict[str, Any]) -> None:
    for title, first, rows in (
        ("Association accuracy, frame by frame", "matched by", ablation["association"]),
        ("PCP by triangulation", "triangulation", ablation["triangulation"]),
        ("A tracker that sees one camera", "measure", ablation["single_view"]),
    ):
        columns = list(next(iter(rows.values())))
        cells = ([name, *(f"{values[column]:.4g}" for column in columns)] for name, values in rows.items())
        print_table([first, *columns], cells, title)
    for title, rows in (
        ("Weights of correspondence", ablation["weights"]),
        ("PCP, every n-th image", ablation["every"]),
    ):
        print_table(list(rows[0]), ([f"{value:.4g}" for value in row.values()] for row in rows), title)
