"""`multicap evaluate`: accuracy of reconstructions against a known truth."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, StageBars, emit, print_table, reporting
from api.cli.options import checked, with_choices
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import open_session
from pipeline.clustering.associate import reconstruct_by_clustering
from pipeline.clustering.parameters import derive_parameters as clustering_parameters
from pipeline.config import Method, ReconstructionConfig
from pipeline.data.animation import Animation
from pipeline.data.cameras import Camera, FrameTimes, Refinement, Timebase
from pipeline.data.detections import Detections
from pipeline.data.people import People
from pipeline.detect.profiles.detection import detection_joints
from pipeline.errors import InputError, Problem
from pipeline.evaluation.camera_errors import camera_errors, disturb_calibration, without_extrinsics
from pipeline.evaluation.datasets.rendered import load_rendered, score_rendered
from pipeline.evaluation.datasets.shelf import NUM_SCORED_ACTORS, load_shelf, score_shelf, thin
from pipeline.evaluation.datasets.shelf_ablation import ablate
from pipeline.evaluation.datasets.shelf_tracking import association_accuracy, score_tracking
from pipeline.evaluation.extremities.feet import score_feet, score_foot_directions, score_heels_and_toes
from pipeline.evaluation.extremities.hands import score_hands
from pipeline.evaluation.simulated import score_simulated
from pipeline.evaluation.simulated_clustering import ablate_clustering, cluster_fields, drawn_fields
from pipeline.identity.identify import identify
from pipeline.job_choices import MAX_STATURE_M, MIN_STATURE_M
from pipeline.joints import COCO_17, COCO_18, FINGER_JOINTS, JointSet
from pipeline.problem_codes.commands import NO_ABLATION, NO_REFINEMENT, UNKNOWN_EVIDENCE, WRONG_NUMBER_OF_VIEWS
from pipeline.quality.report import bone_length_std_cm, mean_jitter_m_s2
from pipeline.simulation.scenes import SCENES, Simulation, find_scene, known_joints, record
from pipeline.skeleton.animate import animate
from pipeline.stages.local import detect_people, reconstruct
from pipeline.stages.refinement import refine_from_bodies
from pipeline.tracking.associate import associate, locate_people, track_bodies
from pipeline.tracking.observations import gather
from pipeline.tracking.parameters import derive_parameters
from pipeline.warm_up import warm_up

# Number of views in the paper's table 3; with all cameras of a dome the six variants would take half an hour.
_ABLATION_VIEWS = 12

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

app = typer.Typer(help="Accuracy against a known truth.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Accuracy against a known truth."""


@app.command()
@with_choices("profile", "joints", "detector", "method", "smoothing", "joint_centers", "refine_calibration")
def rendered(
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
        scores |= _refinement_scores(reconstruction.refinement) | errors
    if as_json:
        emit(scores)
        return
    print_table(("measure", "value"), ((name, _shown(value)) for name, value in scores.items()))


@app.command()
@with_choices("method", "smoothing", "refine_calibration")
def shelf(
    *,
    data: Annotated[Path, typer.Option(help="A folder with calibration.json, gt.npz and detections_*.npz.")],
    chosen: Mapping[str, Any],
    stature_m: StatureOption = None,
    detections: Annotated[Path | None, typer.Option(help="File of other 2D keypoints of the same images.")] = None,
    every: Annotated[
        int, typer.Option(min=1, max=10, help="Keep every n-th image, at a different phase for each camera.")
    ] = 1,
    ablation: Annotated[
        bool, typer.Option(help="Also measure the contribution of each part of the method (half a minute).")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """The Shelf benchmark: 2D keypoints to PCP (images 300-599, mean over actors 1-3), in percent."""
    with reporting(as_json):
        config = checked(chosen)
        whole = load_shelf(data, detections)
        _refuse_ablation(config.method, ablation)
        benchmark, kept = thin(whole, every)
        warm_up()
        started_s = time.perf_counter()
        errors: dict[str, float] = {}
        if stature_m:
            cameras, errors = without_extrinsics(
                benchmark.cameras, benchmark.times, benchmark.detections, COCO_17, stature_m
            )
            benchmark = replace(benchmark, cameras=cameras)
        cameras, refinement = _refined(
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
            identities = associate(*views, limits)
            people = locate_people(*views, identities, benchmark.timebase, limits)
        people = _identified(people, benchmark.cameras, benchmark.timebase, COCO_17, config.method)
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
            **_refinement_scores(refinement),
            **errors,
        }
        if ablation:
            result["ablation"] = ablate(whole)
    if as_json:
        emit(result)
        return
    _print_shelf(result)
    if ablation:
        _print_ablation(result["ablation"])


def _print_shelf(result: dict[str, Any]) -> None:
    pcp = result["pcp"]
    parts = [*pcp["parts"].items(), ("all", pcp["actors"])]
    columns = ["part", *(f"actor {k + 1}" for k in range(NUM_SCORED_ACTORS))]
    print_table(columns, ([name, *(f"{value:.2f}" for value in values)] for name, values in parts))
    rules = ", ".join(f"{rule} {value:.2f}" for rule, value in pcp["by_head_rule"].items())
    typer.echo(f"Average PCP {pcp['average']:.2f} % (by head rule: {rules})")
    if result["association_accuracy"] is not None:
        typer.echo(f"Association accuracy {result['association_accuracy']:.4f}")
    typer.echo(
        f"Identity switches {result['switches']}, ghost tracks {result['ghost_tracks']}, standard deviation of bone "
        f"lengths {result['bone_std_cm']:.2f} cm, {result['fps']:.0f} frames a second"
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


@app.command()
@with_choices("method", "smoothing", "feet", "refine_calibration")
def simulated(
    *,
    scene: Annotated[str, typer.Option(help=f"One of {', '.join(SCENES)}.")],
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
            typer.echo(f"\nClustering's parts, {num_views} cameras (see docs/clustering.md)")
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


def _score(animation: Animation, simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    scores = score_simulated(animation.tracks, simulation, joints)
    scores |= score_feet(animation.tracks, animation.motions, simulation, joints)
    if "left_heel" in simulation.joints.names:
        scores |= score_heels_and_toes(animation.tracks, simulation, joints)
    if not FINGER_JOINTS.isdisjoint(simulation.joints.names):
        scores |= score_hands(animation.tracks, simulation, joints)
    return scores


def _score_bodies(
    simulation: Simulation, true: Sequence[Camera], config: ReconstructionConfig, stature_m: Sequence[float]
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
    cameras, refinement = _refined(
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
    people = _identified(people, simulation.cameras, simulation.timebase, simulation.joints, config.method)
    animation = animate(
        people.tracks, people.observations, simulation.cameras, simulation.timebase, simulation.joints, config
    )
    fps = simulation.timebase.num_frames / (time.perf_counter() - started_s)
    scores = _score(animation, simulation, simulation.joints) | {"fps": fps} | _refinement_scores(refinement) | errors
    if refinement is not None:
        for name, some in (("given", given), ("refined", cameras)):
            scores |= {f"cameras_{name}_{kind}": value for kind, value in camera_errors(true, some).items()}
    return scores


def _refined(
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


def _refinement_scores(refinement: Refinement | None) -> dict[str, Any]:
    """Figures of a refinement; none without a refinement."""
    if refinement is None:
        return {}
    return {
        "refined": refinement.refined,
        "refinement_before_px": refinement.error_before_px,
        "refinement_after_px": refinement.error_after_px,
        "bumped": len(refinement.bumped),
    }


def _identified(
    people: People, cameras: Sequence[Camera], timebase: Timebase, joints: JointSet, method: Method
) -> People:
    """People after the global pass."""
    min_score = 0.0 if method == "clustering" else derive_parameters(cameras, timebase.frame_rate_hz).min_score
    return identify(people, cameras, joints, timebase, min_score)


def _score_fields(simulation: Simulation, config: ReconstructionConfig, ablation: bool) -> dict[str, Any]:
    with drawn_fields(simulation) as files:
        started_s = time.perf_counter()
        people = People(*cluster_fields(simulation, files))
        people = _identified(people, simulation.cameras, simulation.timebase, COCO_18, config.method)
        animation = animate(
            people.tracks, people.observations, simulation.cameras, simulation.timebase, COCO_18, config
        )
        fps = simulation.timebase.num_frames / (time.perf_counter() - started_s)
        scores = _score(animation, simulation, COCO_18)
        parts = {"ablation": ablate_clustering(simulation, files)} if ablation else {}
    return scores | {"fps": fps} | parts


def _print_simulated(columns: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table with a column of scores for each entry, and the errors of the joints in its last rows."""
    first = next(iter(columns.values()))
    rows = [
        [name, *(_shown(scores.get(name)) for scores in columns.values())]
        for name in first
        if not isinstance(first[name], dict)
    ]
    for name in (name for name in first if name.endswith("_by_joint_mm")):
        for joint in first[name]:
            errors = (scores[name][joint] for scores in columns.values())
            rows.append(
                [f"{name.removesuffix('_by_joint_mm')}_mm of the {joint}", *(_shown(error) for error in errors)]
            )
    print_table(["measure", *columns], rows)


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _refuse_ablation(method: Method, ablation: bool) -> None:
    if ablation and method != "tracking":
        problem = Problem(NO_ABLATION, f"There is no ablation of the method '{method}' here.", hint="Omit --ablation.")
        raise InputError([problem])


def _numbers(views: str | None) -> list[int | None]:
    if views is None:
        return [None]
    try:
        return [int(number) for number in views.split(",")]
    except ValueError:
        problem = Problem(WRONG_NUMBER_OF_VIEWS, f"{views!r} is not a list of numbers.", hint="Write them as 4,8,16.")
        raise InputError([problem]) from None
