"""Ablation of cross-view tracking on Shelf (Chen et al. 2020, figures 3 and 4, tables 3, 4 and S1)."""

from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.association.tracking.parameters import derive_parameters
from pipeline.association.tracking.track_people import assign_detections, locate_people
from pipeline.validation.evaluation.datasets.shelf import (
    FRAME_RATE_HZ,
    NUM_SCORED_ACTORS,
    ShelfBenchmark,
    score_shelf,
    thin,
)
from pipeline.validation.evaluation.datasets.shelf_tracking import association_accuracy, score_single_view
from pipeline.validation.evaluation.incremental import Triangulation, locate_incrementally
from pipeline.validation.evaluation.pairwise import associate_pairwise

_WEIGHTS_2D = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
_EVERY = (1, 2, 3, 4, 5, 6, 8, 10)


def ablate(benchmark: ShelfBenchmark) -> dict[str, Any]:
    """Run the whole ablation.

    Returns
    -------
    association
        Association accuracy by camera of cross-view tracking and of matching in pairs of views, identities matched
        frame by frame (figure 3; the paper's other baselines need an appearance network that is not available).
    weights
        Association accuracy and PCP by the weights of 2D and 3D correspondence (table S1).
    triangulation
        PCP of torso, upper arms and lower arms, and average, by triangulation of the same association (table 3).
    every
        PCP by the share of images kept, cameras at different phases (figure 4).
    single_view
        MOTA and IDF1 of a single-view tracker by camera (table 4).
    """
    return {
        "association": _association(benchmark),
        "weights": _weights(benchmark),
        "triangulation": _triangulations(benchmark),
        "every": [_thinned(benchmark, every) for every in _EVERY],
        "single_view": score_single_view(benchmark),
    }


def _association(benchmark: ShelfBenchmark) -> dict[str, dict[str, float | None]]:
    parameters = derive_parameters(benchmark.cameras, FRAME_RATE_HZ)
    views = (benchmark.cameras, benchmark.times, benchmark.detections)
    return {
        "pairs_of_views": association_accuracy(associate_pairwise(*views, parameters), benchmark, by_frame=True),
        "tracking": association_accuracy(assign_detections(*views, parameters), benchmark, by_frame=True),
    }


def _weights(benchmark: ShelfBenchmark) -> list[dict[str, Any]]:
    rows = []
    for weight_2d in _WEIGHTS_2D:
        parameters = replace(
            derive_parameters(benchmark.cameras, FRAME_RATE_HZ), weight_2d=weight_2d, weight_3d=1.0 - weight_2d
        )
        views = (benchmark.cameras, benchmark.times, benchmark.detections)
        identities = assign_detections(*views, parameters)
        tracks = locate_people(*views, identities, benchmark.timebase, parameters).tracks
        rows.append(
            {
                "weight_2d": weight_2d,
                "weight_3d": 1.0 - weight_2d,
                "association_accuracy": association_accuracy(identities, benchmark)["all"],
                "pcp": score_shelf(tracks, benchmark)["pcp"]["average"],
            }
        )
    return rows


def _triangulations(benchmark: ShelfBenchmark) -> dict[str, dict[str, float]]:
    """PCP by kind of triangulation; ``robust`` is the triangulation of whole tracks."""
    parameters = derive_parameters(benchmark.cameras, benchmark.timebase.frame_rate_hz)
    views = (benchmark.cameras, benchmark.times, benchmark.detections)
    identities = assign_detections(*views, parameters)
    by_kind = {}
    for kind in Triangulation:
        tracks, _ = locate_incrementally(*views, identities, benchmark.timebase, parameters, kind)
        by_kind[kind.value] = _parts(score_shelf(tracks, benchmark))
    robust = locate_people(*views, identities, benchmark.timebase, parameters).tracks
    return {**by_kind, "robust": _parts(score_shelf(robust, benchmark))}


def _parts(scores: dict[str, Any]) -> dict[str, float]:
    parts = {
        name: float(np.mean(scores["pcp"]["parts"][name][:NUM_SCORED_ACTORS]))
        for name in ("torso", "upper_arms", "lower_arms")
    }
    return {**parts, "average": scores["pcp"]["average"]}


def _thinned(benchmark: ShelfBenchmark, every: int) -> dict[str, Any]:
    thinned, _ = thin(benchmark, every)
    averages = {kind: parts["average"] for kind, parts in _triangulations(thinned).items()}
    return {"every": every, **averages}
