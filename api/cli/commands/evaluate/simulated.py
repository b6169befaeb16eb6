"""`multicap evaluate simulated`: accuracy on simulated scenes."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.shared import StatureOption, identified, refined, refinement_scores, shown
from api.cli.console import JsonOption, emit, print_table, reporting, shows_help
from api.cli.options import SceneOption, checked, with_choices
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import COCO_18, FINGER_JOINTS, JointSet
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.core.problems.finding_codes import NO_ABLATION, NO_REFINEMENT, UNKNOWN_EVIDENCE, WRONG_NUMBER_OF_VIEWS

if not shows_help():
    from pipeline.association.clustering.cluster_people import reconstruct_by_clustering
    from pipeline.association.clustering.clustering_parameters import derive_parameters as clustering_parameters
    from pipeline.association.tracking.observations import gather
    from pipeline.association.tracking.track_people import track_bodies
    from pipeline.association.tracking.tracking_parameters import derive_parameters
    from pipeline.core.data.animation import Animation
    from pipeline.core.data.cameras import Camera
    from pipeline.core.data.people import People
    from pipeline.motion.skeleton.animate import animate
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.evaluation import simulated
    from pipeline.validation.evaluation.camera_errors import camera_errors, disturb_calibration, without_extrinsics
    from pipeline.validation.evaluation.extremity_errors import score_feet, score_hands, score_heels_and_toes
    from pipeline.validation.simulation.scenes import Simulation, find_scene, known_joints, record

# Number of views in the paper's table 3; with all cameras of a dome the six variants would take half an hour.
_ABLATION_VIEWS = 12


@with_choices("method", "smoothing", "feet", "refine_calibration")
def command(
    *,
    scene: SceneOption,
    seed: Annotated[int, typer.Option(help="Random seed; the same seed gives the same scene.")] = 0,
    chosen: Mapping[str, Any],
    turn: Annotated[
        float, typer.Option(min=0.0, max=5.0, metavar="DEG", help="Angle by which each camera is turned beforehand.")
    ] = 0.0,
    shift: Annotated[
        float, typer.Option(min=0.0, max=0.3, metavar="M", help="Distance by which each camera is shifted beforehand.")
    ] = 0.0,
    stature_m: StatureOption = None,
    duration: Annotated[
        float | None, typer.Option(min=1.0, max=600.0, metavar="S", help="Length in seconds. Default: the scene's.")
    ] = None,
    evidence: Annotated[
        str | None,
        typer.Option(
            help="Evidence: `fields` (part affinity fields; default of clustering) or `bodies` (whole bodies; the "
            "default of tracking)."
        ),
    ] = None,
    joints: Annotated[
        str,
        typer.Option(metavar="body|feet|whole", help="Simulated joints: of the body, with feet, with feet and hands."),
    ] = "body",
    noise: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="PX", help="Noise of the average joint in pixels. Default: the scene's."),
    ] = None,
    views: Annotated[
        str | None,
        typer.Option(help="Numbers of cameras, such as 4,8. Default: all; with --ablation at most the paper's 12."),
    ] = None,
    ablation: Annotated[
        bool,
        typer.Option(
            help="Also measure the contribution of each constraint of clustering (the paper's table 3; minutes)."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Simulated people with exact truth, seen by a simulated detector with faults."""
    by_views: dict[int, dict[str, Any]] = {}
    with reporting(as_json):
        config = checked(chosen)
        checked_evidence = _known_evidence(evidence, config.method, ablation)
        is_refined = config.refine_calibration != "off"
        if checked_evidence == "fields" and (turn or shift or stature_m or is_refined):
            hint = "Use --evidence bodies, or omit --turn, --shift, --stature-m and --refine-calibration."
            raise InputError([Problem(NO_REFINEMENT, "Calibrations are refined here from whole bodies.", hint=hint)])
        checked_joints = known_joints(joints)
        found = find_scene(scene)
        if ablation and views is None:
            views = str(min(_ABLATION_VIEWS, found.rig.num_cameras))
        if noise is not None:
            found = replace(found, detector=replace(found.detector, noise_m=0.0, noise_px=noise))
        if duration is not None:
            found = replace(found, duration_s=duration)
        for num_views in _numbers(views):
            simulation = record(found, seed, num_views, checked_joints)
            warm_up()
            if checked_evidence == "fields":
                scores = _score_fields(simulation, config, ablation)
            else:
                disturbed = disturb_calibration(simulation, turn, shift, seed)
                scores = _score_bodies(disturbed, simulation.cameras, config, stature_m or ())
            by_views[len(simulation.cameras)] = scores
    if as_json:
        emit(
            {
                "scene": scene,
                "seed": seed,
                "method": config.method,
                "evidence": checked_evidence,
                "joints": checked_joints,
                "noise_px": noise,
                "by_views": by_views,
            }
        )
        return
    _print_simulated({f"{num_views} cameras": scores for num_views, scores in by_views.items()})
    if ablation:
        for num_views, scores in by_views.items():
            typer.echo(f"\nClustering's parts, {num_views} cameras (see `multicap help clustering-notes`)")
            _print_simulated(scores["ablation"])


def _known_evidence(evidence: str | None, method: Method, ablation: bool) -> str:
    """Check the evidence from which people are found; by default the method's own."""
    chosen = evidence or ("fields" if method == "clustering" else "bodies")
    problems = []
    if chosen not in {"fields", "bodies"}:
        problems.append(Problem(UNKNOWN_EVIDENCE, f"There is no evidence {chosen!r}.", hint="Known: fields, bodies."))
    elif chosen == "fields" and method != "clustering":
        problems.append(
            Problem(UNKNOWN_EVIDENCE, "Tracking needs whole bodies.", hint="Omit --evidence, or use clustering.")
        )
    if ablation and chosen != "fields":
        hint = "Omit --ablation, or evaluate clustering of fields."
        problems.append(Problem(NO_ABLATION, "Only clustering of fields has an ablation here.", hint=hint))
    if problems:
        raise InputError(problems)
    return chosen


def _score(animation: "Animation", simulation: "Simulation", joints: JointSet) -> dict[str, Any]:
    scores = simulated.score_simulated(animation.tracks, simulation, joints)
    scores |= score_feet(animation.tracks, animation.motions, simulation, joints)
    if "left_heel" in simulation.joints.names:
        scores |= score_heels_and_toes(animation.tracks, simulation, joints)
    if not FINGER_JOINTS.isdisjoint(simulation.joints.names):
        scores |= score_hands(animation.tracks, simulation, joints)
    return scores


def _score_bodies(
    simulation: "Simulation", true: "Sequence[Camera]", config: ReconstructionConfig, stature_m: Sequence[float]
) -> dict[str, Any]:
    """Score a simulation with bodies; its calibration may be disturbed, or made from people of given statures."""
    started_s = time.perf_counter()
    errors: dict[str, float] = {}
    if stature_m:
        cameras, errors = without_extrinsics(
            simulation.cameras, simulation.times, simulation.detections, simulation.joints, stature_m
        )
        simulation = replace(simulation, cameras=cameras)
    given = simulation.cameras
    cameras, refinement = refined(
        given, simulation.times, simulation.detections, simulation.timebase, simulation.joints, config
    )
    simulation = replace(simulation, cameras=cameras)
    views = (simulation.cameras, simulation.times, simulation.detections, simulation.timebase)
    if config.method == "clustering":
        parameters = clustering_parameters(simulation.cameras)
        people = People(*reconstruct_by_clustering(*views, simulation.joints, parameters))
    else:
        limits = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
        bodies = gather(simulation.cameras, simulation.times, simulation.detections)
        people = track_bodies(simulation.cameras, simulation.times, bodies, simulation.timebase, limits)
    people = identified(people, simulation.cameras, simulation.times, simulation.timebase, simulation.joints, config)
    animation = animate(
        people.tracks, people.observations, simulation.cameras, simulation.timebase, simulation.joints, config
    )
    fps = simulation.timebase.num_frames / (time.perf_counter() - started_s)
    scores = _score(animation, simulation, simulation.joints) | {"fps": fps} | refinement_scores(refinement) | errors
    if refinement is not None:
        for name, some in (("given", given), ("refined", cameras)):
            scores |= {f"cameras_{name}_{kind}": value for kind, value in camera_errors(true, some).items()}
    return scores


def _score_fields(simulation: "Simulation", config: ReconstructionConfig, ablation: bool) -> dict[str, Any]:
    with simulated.drawn_fields(simulation) as files:
        started_s = time.perf_counter()
        people = People(*simulated.cluster_fields(simulation, files))
        people = identified(people, simulation.cameras, simulation.times, simulation.timebase, COCO_18, config)
        animation = animate(
            people.tracks, people.observations, simulation.cameras, simulation.timebase, COCO_18, config
        )
        fps = simulation.timebase.num_frames / (time.perf_counter() - started_s)
        scores = _score(animation, simulation, COCO_18)
        parts = {"ablation": simulated.ablate_clustering(simulation, files)} if ablation else {}
    return scores | {"fps": fps} | parts


def _print_simulated(columns: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table with a column of scores for each entry, and the errors of the joints in its last rows."""
    first = next(iter(columns.values()))
    rows = [
        [name, *(shown(scores.get(name)) for scores in columns.values())]
        for name in first
        if not isinstance(first[name], dict)
    ]
    for name in (name for name in first if name.endswith("_by_joint_mm")):
        for joint in first[name]:
            errors = (scores[name][joint] for scores in columns.values())
            rows.append([f"{name.removesuffix('_by_joint_mm')}_mm of the {joint}", *(shown(error) for error in errors)])
    print_table(["measure", *columns], rows)


def _numbers(views: str | None) -> list[int | None]:
    if views is None:
        return [None]
    try:
        return [int(number) for number in views.split(",")]
    except ValueError:
        problem = Problem(WRONG_NUMBER_OF_VIEWS, f"{views!r} is not a list of numbers.", hint="Write them as 4,8,16.")
        raise InputError([problem]) from None
