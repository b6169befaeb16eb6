"""Accuracy of tracks on simulated scenes: joint errors, MOTA, IDF1, and hands that touch."""

import itertools
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.clustering.cluster_people import reconstruct_evidence
from pipeline.association.clustering.clustering_parameters import ClusteringParameters, derive_parameters
from pipeline.association.clustering.instant.candidates import FieldEvidence
from pipeline.association.clustering.skeleton import clustering_skeleton
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.detections import PafFields
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.joints import COCO_18, JointSet
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.core.runtime.record_archive import decode, save
from pipeline.export.quality.report import bone_length_std_cm, mean_jitter_m_s2
from pipeline.run.engine.stage import FrameCut
from pipeline.validation.evaluation import mpjpe
from pipeline.validation.evaluation.mpjpe import MotFrame, score_mot
from pipeline.validation.simulation.scenes import Simulation
from pipeline.validation.simulation.views.fields import GRID, render
from pipeline.video.timeline import span_s

_WRISTS = [mpjpe.BODY_JOINTS.index(f"{side}_wrist") for side in ("left", "right")]
# Distance of a wrist from a joint of another person who is touched, and from the true wrist if it counts as found.
_TOUCH_M, _HAND_M = 0.25, 0.15


def score_simulated(tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    """Score tracks over the twelve joints of the body.

    The result has:

    - ``mpjpe_mm``, ``recall``, ``ghost_rate``, ``switches``: see ``evaluation.mpjpe``.
    - ``mota``, ``idf1``: see ``evaluation.mpjpe``; pairs match within 0.5 m.
    - ``bone_std_cm``, ``jitter_m_s2``: see ``quality.report``; ``None`` without tracks.
    - ``people_correct``: share of frames with as many tracks as people.
    - ``hands_kept``: share of the frames with two touching people in which all four wrists are within 0.15 m of the
      truth; ``None`` if no person touches another.
    - ``mpjpe_by_joint_mm``: mean error by kind of joint, left and right together, for the twelve joints, nose and neck.
    """
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(mpjpe.BODY_JOINTS)]
    predicted_m = mpjpe.select_joints(tracks, joints, mpjpe.BODY_JOINTS, frames)
    there = np.isfinite(predicted_m).all(-1).any(-1)
    scores = mpjpe.accuracy(predicted_m, truth_m)
    error_m = _errors_m(predicted_m, truth_m, mpjpe.match_frames(predicted_m, truth_m))
    mot = score_mot([_mot_frame(truth_m[:, k], predicted_m[:, k]) for k in frames])
    return {
        "mpjpe_mm": scores.mpjpe_mm,
        "mota": mot.mota,
        "idf1": mot.idf1,
        "switches": scores.switches,
        "bone_std_cm": bone_length_std_cm(tracks, joints) if tracks else None,
        "jitter_m_s2": mean_jitter_m_s2(tracks, simulation.timebase.frame_rate_hz) if tracks else None,
        "people_correct": float(np.mean(there.sum(0) == simulation.present.sum(0))),
        "recall": scores.recall,
        "ghost_rate": scores.ghost_rate,
        "hands_kept": _hands_kept(error_m, truth_m),
        "mpjpe_by_joint_mm": _by_joint_mm(tracks, simulation, joints, mpjpe.match_frames(predicted_m, truth_m)),
    }


def _errors_m(
    predicted_m: Float[np.ndarray, "tracks frames joints 3"],
    truth_m: Float[np.ndarray, "people frames joints 3"],
    matched: Int[np.ndarray, "people frames"],
) -> Float[np.ndarray, "people frames joints"]:
    """Distance of each true joint to the matched track's joint, NaN without a match."""
    no_person = np.full((1, *predicted_m.shape[1:]), np.nan)
    of_match_m = np.concatenate([predicted_m, no_person])[matched, np.arange(truth_m.shape[1])]
    return np.linalg.norm(of_match_m - truth_m, axis=-1)


def _by_joint_mm(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet, matched: Int[np.ndarray, "people frames"]
) -> dict[str, float | None]:
    """Mean error of each kind of joint (Chen et al. 2020, table 2); the true neck is the midpoint of the shoulders."""
    names = ("nose", "neck", *mpjpe.BODY_JOINTS)
    body_m = simulation.truth_m[:, :, simulation.joints.indices(("nose", *mpjpe.BODY_JOINTS))]
    truth_m = np.insert(body_m, 1, body_m[:, :, 1:3].mean(2), axis=2)
    predicted_m = mpjpe.select_joints(tracks, joints, names, np.arange(simulation.timebase.num_frames))
    error_m = _errors_m(predicted_m, truth_m, matched)
    kinds = [name.rpartition("_")[2] for name in names]
    return {
        kind: float(np.nanmean(of_kind_m)) * 1000 if np.isfinite(of_kind_m).any() else None
        for kind in dict.fromkeys(kinds)
        for of_kind_m in [error_m[..., np.array([other == kind for other in kinds])]]
    }


def _hands_kept(
    error_m: Float[np.ndarray, "people frames joints"], truth_m: Float[np.ndarray, "people frames joints 3"]
) -> float | None:
    """Share of the frames of touching pairs in which both people have both wrists."""
    has_both = np.asarray((error_m[..., _WRISTS] <= _HAND_M).all(-1))
    num_kept = num_touching = 0
    for first, second in itertools.combinations(range(len(truth_m)), 2):
        apart_m = [
            np.linalg.norm(truth_m[a][:, _WRISTS, None] - truth_m[b][:, None], axis=-1)
            for a, b in ((first, second), (second, first))
        ]
        touching = np.nanmin(np.where(np.isnan(apart_m), np.inf, apart_m), axis=(0, 2, 3)) < _TOUCH_M
        num_touching += int(touching.sum())
        num_kept += int((touching & has_both[first] & has_both[second]).sum())
    return num_kept / num_touching if num_touching else None


def _mot_frame(truth_m: np.ndarray, predicted_m: np.ndarray) -> MotFrame:
    """Make the record of a frame; the similarity of a pair at the gate is 0.5, the threshold of ``trackeval``."""
    people = np.flatnonzero(np.isfinite(truth_m).all(-1).any(-1))
    tracks = np.flatnonzero(np.isfinite(predicted_m).all(-1).any(-1))
    distance_m = mpjpe.mean_distance_m(predicted_m[tracks], truth_m[people])
    return MotFrame(people, tracks, np.maximum(0.0, 1.0 - distance_m / (2 * mpjpe.GATE_M)))


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

    ``files`` have the fields of the simulation, see ``drawn_fields``; ``changes`` differ from the default parameters,
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
