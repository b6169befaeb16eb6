"""A simulated take of two people, and faults that are planted in what a person's cameras see."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import Correction, ExchangeSides
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.animate import PersonFitter, animate
from pipeline.motion.skeleton.corrections.correct import correct_person
from pipeline.motion.skeleton.corrections.evidence import corrected_evidence
from pipeline.validation.evaluation import mpjpe
from pipeline.validation.simulation.scenes import Joints, Simulation, find_scene, record

CONFIG = ReconstructionConfig()
Person = tuple[Track3D, SkeletonMotion]


@dataclass(frozen=True, eq=False)
class FaultyTake:
    """A simulated take that was reconstructed, and the first of its people."""

    simulation: Simulation
    located: Track3D
    seen: Observations
    animation: Animation

    @property
    def person(self) -> Person:
        """Final track and motion of the person."""
        return self.animation.tracks[0], self.animation.motions[0]

    @property
    def fitter(self) -> PersonFitter:
        simulation = self.simulation
        return PersonFitter(simulation.cameras, simulation.timebase, simulation.joints, CONFIG, {})

    @property
    def truth_m(self) -> np.ndarray:
        """True joints of the person in the track's frames."""
        track, _ = self.person
        truth_m = self.simulation.truth_m[:, track.frames]
        return truth_m[np.nanmean(np.linalg.norm(truth_m - track.xyz_m, axis=-1), axis=(1, 2)).argmin()]

    def index(self, joint: str) -> int:
        return self.simulation.joints.index(joint)

    def error_mm(self, track: Track3D, rows: slice = slice(None)) -> float:
        """Mean error of the twelve joints of the body."""
        columns = self.simulation.joints.indices(mpjpe.BODY_JOINTS)
        off_m = np.linalg.norm(track.xyz_m[:, columns] - self.truth_m[:, columns], axis=-1)
        return 1000 * float(np.nanmean(off_m[rows]))

    def corrected(self, corrections: Sequence[Correction]) -> Person:
        simulation = self.simulation
        evidence = corrected_evidence(self.located, self.seen, corrections, simulation.cameras, simulation.joints)
        return correct_person(self.fitter, *self.person, evidence, corrections, self.animation.floor)

    def with_fault(self, located: Track3D, seen: Observations) -> "FaultyTake":
        """The take as it is if association located and saw other joints."""
        simulation = self.simulation
        floor = self.animation.floor
        take = simulation.cameras, simulation.timebase, simulation.joints, CONFIG
        return FaultyTake(simulation, located, seen, animate([located], [seen], *take, floor=floor))

    def sides_exchanged(self, rows: slice) -> "FaultyTake":
        frames = self.located.frames[rows]
        exchange = ExchangeSides(person=1, part="all", start_frame=frames.start, stop_frame=frames.stop)
        simulation = self.simulation
        evidence = corrected_evidence(self.located, self.seen, [exchange], simulation.cameras, simulation.joints)
        return self.with_fault(evidence.located, evidence.seen)

    def seen_elsewhere(self, joint: str, rows: slice, off_m: np.ndarray, cameras: Sequence[int]) -> "FaultyTake":
        """The take if some cameras see a joint elsewhere, and the other cameras do not see it."""
        points_px, score = np.array(self.seen.points_px), np.array(self.seen.score)
        column, located_m = self.index(joint), np.array(self.located.xyz_m)
        points_px[rows, :, column], score[rows, :, column] = np.nan, 0.0
        located_m[rows, column] = np.nan
        for number in cameras:
            located_m[rows, column] = self.truth_m[rows, column] + off_m
            points_px[rows, number, column] = project(self.simulation.cameras[number], located_m[rows, column])
            score[rows, number, column] = 0.9
        source = np.array(self.located.source)
        source[rows, column] = Source.MEASURED if len(cameras) > 1 else Source.ABSENT
        seen = replace(self.seen, points_px=points_px, score=score)
        return self.with_fault(replace(self.located, xyz_m=located_m, source=source), seen)


@cache
def taken(joints: Joints = "body", duration_s: float = 6.0, seed: int = 11, scene: str = "room") -> FaultyTake:
    """Reconstruct the first person of a simulated scene."""
    simulation = record(replace(find_scene(scene), duration_s=duration_s), seed, joints=joints)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    take = simulation.cameras, simulation.times, simulation.detections, simulation.timebase
    tracks, seen = reconstruct_tracks(*take, parameters)
    animation = animate(tracks, seen, simulation.cameras, simulation.timebase, simulation.joints, CONFIG)
    return FaultyTake(simulation, tracks[0], seen[0], animation)
