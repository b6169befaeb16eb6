"""`multicap benchmark tracking` and `clustering`: their speed, and the cost of tracking by number of cameras."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, emit, print_table, reporting, require_writable, show_sizes, shows_help
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.core.joints import COCO_18

if not shows_help():
    import numpy as np

    from pipeline.association.clustering import clustering_parameters
    from pipeline.association.clustering.cluster_people import find_poses, first_lengths, sampled_frames
    from pipeline.association.clustering.instant.candidates import FieldEvidence
    from pipeline.association.clustering.skeleton import clustering_skeleton
    from pipeline.association.tracking.track_people import reconstruct_tracks
    from pipeline.association.tracking.tracking_parameters import derive_parameters
    from pipeline.geometry.camera import image_from_world
    from pipeline.run.warm_up import warm_up
    from pipeline.validation.evaluation.baselines import associate_pairwise
    from pipeline.validation.simulation.motion.director import Cast
    from pipeline.validation.simulation.rigs import Clock, Layout, Rig
    from pipeline.validation.simulation.scenes import SCENES, Scene, Simulation, record
    from pipeline.validation.simulation.views.detector import DetectorAccuracy
    from pipeline.validation.simulation.views.faults import NO_FAULTS
    from pipeline.validation.simulation.views.fields import GRID, render

    # Detector with 3 px of noise and no other faults.
    _DETECTOR = DetectorAccuracy(noise_m=0.0, noise_px=3.0, faults=NO_FAULTS)

RATE_HZ = 25.0
# Cameras, people and seconds.
_SIZES = ((3, 3, 60.0), (5, 4, 60.0), (12, 4, 40.0), (28, 16, 20.0))
_NUM_CAMERAS = (2, 4, 8, 12, 16, 20, 24, 28, 31)
_NUM_DOME_PEOPLE = 7
_DOME_S = 10.0
_REPEATS = 15
# The time of the baseline grows so fast that it is not measured with more cameras once a frame takes this long.
_PAIRWISE_FRAMES = 4
_PAIRWISE_LIMIT_MS = 2000.0
_NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


def crowd(num_cameras: int, num_people: int, duration_s: float, rate_hz: float = RATE_HZ) -> "Simulation":
    """Simulate people who improvise on 4 m^2 each, with cameras around them and ideal lenses."""
    side_m = 2.0 * np.sqrt(num_people)
    around_m = (side_m / 2 + 3.0, side_m / 2 + 3.0)
    layout = Layout.RING if num_cameras <= 6 else Layout.CEILING
    rig = Rig(layout, num_cameras, around_m, 2.6, distortion=_NO_DISTORTION)
    cast = Cast(num_people, (side_m, side_m))
    return record(Scene(rig, cast, Clock(rate_hz), _DETECTOR, duration_s=duration_s), seed=0)


def _dome(num_cameras: int, duration_s: float) -> "Simulation":
    """Simulate the same people for any number of cameras; all cameras see all of them."""
    rig = Rig(Layout.DOME, 31, (4.5, 4.5), 0.9, (1920, 1080), 1000.0, distortion=_NO_DISTORTION)
    cast = Cast(_NUM_DOME_PEOPLE, (3.0, 3.0), gap_m=0.5, walking=0.25)
    return record(Scene(rig, cast, Clock(RATE_HZ), _DETECTOR, duration_s=duration_s), 0, num_cameras)


def shortest_s(work: Callable[[], object], repeats: int) -> float:
    """Shortest of several times: other programs on the machine can only make a time longer."""
    best_s = np.inf
    for _ in range(repeats):
        started_s = time.perf_counter()
        work()
        best_s = min(best_s, time.perf_counter() - started_s)
    return best_s


def _track_s(simulation: "Simulation", repeats: int = _REPEATS) -> float:
    """Time from keypoints in memory to tracks in memory."""
    parameters = derive_parameters(simulation.cameras, RATE_HZ)
    views = (simulation.cameras, simulation.times, simulation.detections)
    return shortest_s(lambda: reconstruct_tracks(*views, simulation.timebase, parameters), repeats)


def _pairwise_ms(num_cameras: int) -> float:
    simulation = _dome(num_cameras, _PAIRWISE_FRAMES / RATE_HZ)
    parameters = derive_parameters(simulation.cameras, RATE_HZ)
    views = (simulation.cameras, simulation.times, simulation.detections)
    return 1e3 * shortest_s(lambda: associate_pairwise(*views, parameters), 1) / simulation.timebase.num_frames


def measure_sizes() -> list[dict[str, Any]]:
    """Frames a second at each size; a frame counts when all cameras were updated once."""
    sizes = []
    for num_cameras, num_people, duration_s in _SIZES:
        simulation = crowd(num_cameras, num_people, duration_s)
        fps = simulation.timebase.num_frames / _track_s(simulation)
        sizes.append({"cameras": num_cameras, "people": num_people, "fps": fps})
    return sizes


def measure_scaling() -> list[dict[str, Any]]:
    """Milliseconds a frame by number of cameras, of the tracker and, up to its limit, of the pairwise baseline."""
    scaling: list[dict[str, Any]] = []
    pairwise_ms: float | None = 0.0
    for num_cameras in _NUM_CAMERAS:
        simulation = _dome(num_cameras, _DOME_S)
        ms = 1e3 * _track_s(simulation) / simulation.timebase.num_frames
        if pairwise_ms is not None:
            pairwise_ms = _pairwise_ms(num_cameras) if pairwise_ms < _PAIRWISE_LIMIT_MS else None
        scaling.append({"cameras": num_cameras, "ms": ms, "pairwise_ms": pairwise_ms})
    return scaling


def plot_scaling(scaling: list[dict[str, Any]], path: Path) -> None:
    """Draw the time of a frame against the number of cameras."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow to load

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    cameras = [point["cameras"] for point in scaling]
    axes.plot(cameras, [point["ms"] for point in scaling], "o-", label="cross-view tracking")
    known = [point for point in scaling if point["pairwise_ms"] is not None]
    axes.plot(
        [point["cameras"] for point in known],
        [point["pairwise_ms"] for point in known],
        "s--",
        label="pairs of views (baseline)",
    )
    axes.set(xlabel="cameras", ylabel="milliseconds a frame", yscale="log", xlim=(0, 32))
    axes.set_title(f"{_NUM_DOME_PEOPLE} people, one core")
    axes.grid(visible=True, which="major", alpha=0.3)
    axes.legend()
    figure.savefig(path)


def tracking(
    plot: Annotated[
        Path | None, typer.Option(help="File for a plot of the time of a frame against the number of cameras.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Time tracking on one core, from keypoints in memory to tracks in memory; simulated people, 3 px of noise."""
    with reporting(as_json):
        require_writable(plot)
        warm_up()
        sizes, scaling = measure_sizes(), measure_scaling()
        if plot is not None:
            plot_scaling(scaling, plot)
    ms = {point["cameras"]: point["ms"] for point in scaling}
    growth = ms[_NUM_CAMERAS[-1]] / ms[4]
    if as_json:
        emit({"sizes": sizes, "scaling": scaling, "growth": growth})
        return
    names = ("cameras", "people", "fps")
    print_table(
        ("cameras", "people", "frames a second"),
        ([f"{size[name]:.0f}" for name in names] for size in sizes),
    )
    print_table(
        ("cameras", "ms a frame", "pairs of views"),
        (
            (
                str(point["cameras"]),
                f"{point['ms']:.3f}",
                "" if point["pairwise_ms"] is None else f"{point['pairwise_ms']:.1f}",
            )
            for point in scaling
        ),
    )
    typer.echo(f"{_NUM_CAMERAS[-1]} cameras take {growth:.2f} times as long as 4.")


# Scenes (of 4 and of 7 people) and numbers of cameras.
_CLUSTERED = (("noisy", 5), ("crowd", 12))
_DURATION_S = 2.0
_NUM_TIMES = 3


def _poses_s(simulation: "Simulation") -> float:
    """Shortest of several times for all frames, with known bone lengths of all people."""
    cameras, timebase = simulation.cameras, simulation.timebase
    parameters = clustering_parameters.derive_parameters(cameras, GRID.tau2)
    skeleton = clustering_skeleton(COCO_18)
    projections = np.array([image_from_world(camera) for camera in cameras])
    fields = render(simulation.sketches, simulation.times, (-np.inf, np.inf))
    seen = FieldEvidence(cameras, simulation.times, fields, timebase, skeleton, parameters)
    sampled = [(seen, sampled_frames(timebase, parameters))]
    lengths = first_lengths(cameras, sampled, timebase, skeleton, parameters)
    instants = [seen.at(frame) for frame in range(timebase.num_frames)]

    def find_all() -> None:
        for instant in instants:
            find_poses(projections, instant, skeleton, lengths, parameters, WorkLimits())

    return shortest_s(find_all, _NUM_TIMES)


def measure_clustering() -> list[dict[str, Any]]:
    """Frames a second at each size; a frame counts when all cameras were updated once."""
    sizes = []
    for scene, num_cameras in _CLUSTERED:
        simulation = record(replace(SCENES[scene], duration_s=_DURATION_S), 0, num_cameras)
        fps = simulation.timebase.num_frames / _poses_s(simulation)
        sizes.append({"cameras": num_cameras, "people": len(simulation.truth_m), "fps": fps})
    return sizes


def clustering(
    as_json: JsonOption = False,
) -> None:
    """Time clustering on one core, from peaks and fields in memory to poses in memory; simulated people."""
    with reporting(as_json):
        warm_up()
        sizes = measure_clustering()
    show_sizes(sizes, as_json)
