"""Hypothesis clustering of simulated people from heatmaps and part affinity fields, and its ablation.

The ablation has the variants of the paper's table 3 (Chen et al. 2020): hypotheses are constrained by reprojection
error alone (``RE``), by connectivity (``+PAF``), by bone lengths (``+BL``), or by both (``All``). In these variants a
cluster gives one joint and ``leniency`` is 1, as in the paper. Further variants are the default parameters
(``default``) and the default without the split of clusters by parents (``unsplit``). Joints are not smoothed.
"""

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.association.clustering.cluster_people import reconstruct_evidence
from pipeline.association.clustering.instant.candidates import FieldEvidence
from pipeline.association.clustering.parameters import ClusteringParameters, derive_parameters
from pipeline.association.clustering.skeleton import clustering_skeleton
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.detections import PafFields
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import COCO_18
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.run.engine.codec import decode, save
from pipeline.run.engine.stage import FrameCut
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import Simulation
from pipeline.validation.simulation.views.fields import GRID, render
from pipeline.video.timeline import span_s

_CHUNK_FRAMES = 25
_PAPERS = {"separate_clusters": False, "leniency": 1.0}
_VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "RE": {**_PAPERS, "use_connectivity": False, "use_lengths": False},
    "+PAF": {**_PAPERS, "use_lengths": False},
    "+BL": {**_PAPERS, "use_connectivity": False},
    "All": _PAPERS,
    "unsplit": {"split_clusters": False},
    "default": {},
}


class FieldFiles:
    """Files of the fields of all cameras, so that memory does not grow with the session: one a camera and range.

    ``folder`` must be empty.
    """

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self._folder, self._cameras = folder, tuple(cameras)

    def write(self, camera: str, frames: range, fields: PafFields) -> None:
        """Write the fields of a camera in a range of output frames."""
        save(fields, self._path(camera, frames))

    def read(self, frames: range) -> dict[str, PafFields]:
        """Read the fields of all cameras for a range, by camera name."""
        return {camera: decode(PafFields, self._path(camera, frames)) for camera in self._cameras}

    def _path(self, camera: str, frames: range) -> Path:
        return self._folder / f"{self._cameras.index(camera)}-{frames.start}.npz"


@contextmanager
def drawn_fields(simulation: Simulation) -> Iterator[FieldFiles]:
    """Draw the fields of all cameras to files in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        files = FieldFiles(Path(folder), [camera.name for camera in simulation.cameras])
        for frames in _ranges(simulation.timebase):
            span = span_s(simulation.timebase, frames.start, frames.stop)
            for camera, fields in render(simulation.sketches, simulation.times, span).items():
                files.write(camera, frames, fields)
        yield files


def cluster_fields(
    simulation: Simulation, files: FieldFiles, changes: Mapping[str, Any] = MappingProxyType({})
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Reconstruct tracks of ``COCO_18`` joints, and the observations behind them.

    ``files`` have the fields of the simulation, see ``drawn_fields``; ``changes`` are those of the default parameters,
    by name.
    """
    parameters: ClusteringParameters = replace(derive_parameters(simulation.cameras, GRID.tau2), **changes)
    skeleton, timebase = clustering_skeleton(COCO_18), simulation.timebase

    def evidence_in(frames: range) -> FieldEvidence:
        fields = files.read(frames)
        return FieldEvidence(simulation.cameras, simulation.times, fields, timebase, skeleton, parameters)

    return reconstruct_evidence(simulation.cameras, evidence_in, _ranges(timebase), timebase, COCO_18, parameters)


def ablate_clustering(simulation: Simulation, files: FieldFiles) -> dict[str, dict[str, Any]]:
    """Score each variant by ``score_simulated``, in parallel on all cores; returns scores by variant."""
    score = partial(_score_variant, simulation, files)
    with ProcessPool(min(len(_VARIANTS), os.cpu_count() or 1)) as pool:
        return dict(zip(_VARIANTS, pool.map(score, _VARIANTS.values()), strict=True))


def _score_variant(simulation: Simulation, files: FieldFiles, changes: Mapping[str, Any]) -> dict[str, Any]:
    return score_simulated(cluster_fields(simulation, files, changes)[0], simulation, COCO_18)


def _ranges(timebase: Timebase) -> list[range]:
    whole = range(timebase.num_frames)
    return list(FrameCut(whole, (whole,), _CHUNK_FRAMES))
