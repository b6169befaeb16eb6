"""Association: steps of both methods from detections in a session to tracks.

``tracking`` is one sequential pass. ``clustering`` first measures everybody's bones over the whole session, then finds
people in each range of frames by itself, and then links them. At last a global pass over either method's tracks finds
out who is who. Detections are whole bodies (``Detections``) or peaks
and fields (``PafFields``), at least of the range.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.association.clustering import cluster_people
from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.clustering_parameters import derive_parameters as derive_clustering
from pipeline.association.clustering.instant.candidates import BodyEvidence, FieldEvidence, ViewEvidence
from pipeline.association.clustering.skeleton import LimbLengths, clustering_skeleton
from pipeline.association.hands.attach import attach_hands
from pipeline.association.identity.alone import follow_alone
from pipeline.association.identity.identify import identify
from pipeline.association.identity.losses import find_losses
from pipeline.association.identity.neighbours import return_limbs
from pipeline.association.identity.sides import decide_sides
from pipeline.association.redetection.accept import accept
from pipeline.association.tracking.observations import Detections2D, gather
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.association.tracking.tracking_parameters import derive_parameters as derive_tracking
from pipeline.capture.session import Session
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import DamagedVideo, Detections, DetectionsByCamera, PafFields
from pipeline.core.data.people import Leftovers, People, Poses3D
from pipeline.core.joints import JointSet, without_hands
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.rules import change_parameters
from pipeline.core.progress import OnShare, ignore
from pipeline.detection.bodies import concatenate
from pipeline.detection.entries import find_entry
from pipeline.run.engine.detection_source import detection_source
from pipeline.run.engine.stage import Context
from pipeline.run.engine.wanted_frames import wanted_frames
from pipeline.video.timeline import frames_in, num_recorded, span_s


class MeasuredBones(NamedTuple):
    """Everybody's bone lengths, and the damaged videos among those that they were measured in."""

    lengths: LimbLengths
    damaged: tuple[DamagedVideo, ...]


def tracking_parameters(
    cameras: Sequence[Camera], timebase: Timebase, changes: Mapping[str, float] = MappingProxyType({})
) -> TrackingParameters:
    """Derive the tracker's parameters from the cameras and the frames, with changes by name.

    A person in fewer than ``confirm_instants`` frames is confirmed by all of them. Raises ``InputError`` if a changed
    parameter does not exist, or can't have that value.
    """
    derived = derive_tracking(cameras, timebase.frame_rate_hz)
    confirm_instants = min(derived.confirm_instants, timebase.num_frames)
    return change_parameters(replace(derived, confirm_instants=confirm_instants), changes)


def clustering_parameters(
    cameras: Sequence[Camera], config: ReconstructionConfig, finds_fields: bool
) -> ClusteringParameters:
    """Derive the parameters of clustering from the cameras and the detector, with the configuration's changes.

    Raises ``InputError`` if a changed parameter does not exist, or can't have that value.
    """
    fields = find_entry(config.networks.body).fields if finds_fields else None
    own = {} if fields is None else {"tau2": fields.tau2}
    return change_parameters(derive_clustering(cameras, **own), config.clustering)


@dataclass(frozen=True, slots=True)
class Association:
    """Cameras, times, joints and choices by which detections become people."""

    cameras: tuple[Camera, ...]
    times: Mapping[str, FrameTimes]
    timebase: Timebase
    joints: JointSet  # Joints of people, without fingers
    config: ReconstructionConfig
    finds_fields: bool = False  # True if a network found the detections as peaks and fields

    def track(self, bodies: Detections2D, on_share: OnShare = ignore) -> People:
        """Track people by cross-view tracking: one pass in time order.

        ``bodies`` are the bodies of all cameras that ``gather`` gives, without fingers.
        """
        timebase = self.timebase
        approximate: set[int] = set()
        people = track_bodies(
            self.cameras,
            self.times,
            bodies,
            timebase,
            self._tracking,
            on_share,
            lambda time_s: approximate.add(round((time_s - timebase.start_time_s) * timebase.frame_rate_hz)),
        )
        return people._replace(num_approximate_frames=len(approximate))

    def measure_bones(
        self, chunks: Iterable[tuple[range, DetectionsByCamera]], on_frame: Callable[[], None] = lambda: None
    ) -> LimbLengths:
        """Measure the bones of all people in a first pass over frames all over the session.

        ``chunks`` are ranges of output frames in order of time, with their detections; read one at a time.
        """
        sampled = cluster_people.sampled_frames(self.timebase, self._clustering)
        evidence = (
            (self._evidence(frames, detections), [frame for frame in frames if frame in sampled])
            for frames, detections in chunks
        )
        skeleton = clustering_skeleton(self.joints)
        return cluster_people.first_lengths(self.cameras, evidence, self.timebase, skeleton, self._clustering, on_frame)

    def locate_people(
        self,
        frames: range,
        detections: DetectionsByCamera,
        lengths: LimbLengths,
        on_frame: Callable[[], None] = lambda: None,
    ) -> Poses3D:
        """Find all people in a range of output frames; the result does not depend on the cut into ranges."""
        evidence, skeleton = self._evidence(frames, detections), clustering_skeleton(self.joints)
        return cluster_people.find_people(self.cameras, evidence, frames, skeleton, lengths, self._clustering, on_frame)

    def link(self, chunks: Iterable[Poses3D], on_share: OnShare = ignore) -> People:
        """Link the poses of all ranges to tracks."""
        poses = cluster_people.join_poses(chunks)
        people = cluster_people.link_people(self.cameras, poses, self.timebase, self.joints, self._clustering, on_share)
        return People(*people, len(poses.approximate))

    def assign_identities(
        self, people: People, colour: UInt8[np.ndarray, "detections parts bins"] | None = None
    ) -> People:
        """Find out who is who among the tracks of either method; see ``pipeline.association.identity.identify``."""
        recorded = num_recorded(self.timebase, (times.time_s for times in self.times.values()))
        num_people = self.config.num_people
        return identify(people, self.cameras, self.joints, self.timebase, self._min_score, num_people, colour, recorded)

    def accept_redetected(self, people: People, found: Iterable[Detections]) -> People:
        """Give people the bodies that were detected again; see ``pipeline.association.redetection.accept``.

        ``found`` are bodies by range and camera, of each camera in order of time.
        """
        bodies = concatenate(found, [camera.name for camera in self.cameras], len(self.joints.names))
        cameras = self.cameras, self.times, self.timebase
        return accept(people, bodies, *cameras, self.joints, self._min_score, self._tracking.lambda_t_hz)

    def assign_limbs(self, people: People) -> People:
        """Give each limb one person and one side; see ``pipeline.association.identity.neighbours`` and ``.sides``."""
        setting = self.cameras, self.timebase, self.joints, self._min_score
        persons = return_limbs(list(zip(people.tracks, people.observations, strict=True)), *setting)
        sided = [decide_sides(person, *setting) for person in persons]
        numbers = [track.track_id for track in people.tracks]
        return people._replace(
            tracks=tuple(replace(track, track_id=k) for (track, _), k in zip(sided, numbers, strict=True)),
            observations=tuple(replace(seen, track_id=k) for (_, seen), k in zip(sided, numbers, strict=True)),
        )

    def follow_by_one_camera(self, people: People, left: Leftovers | None) -> People:
        """Continue people seen by one camera alone; see ``pipeline.association.identity.alone``.

        ``left`` are the bodies without a person after association; ``None`` where it takes joints one by one.
        """
        if left is None:
            return people
        persons = list(zip(people.tracks, people.observations, strict=True))
        followed = follow_alone(persons, left, self.cameras, self.timebase, self._min_score)
        return people._replace(
            tracks=tuple(track for track, _ in followed), observations=tuple(seen for _, seen in followed)
        )

    def find_losses(self, people: People) -> People:
        """Add the frames in which people vanish in the middle of the room; see ``identity.losses``."""
        vanished = find_losses(people.tracks, self.cameras, self.times, self.timebase)
        return people._replace(losses=[*people.losses, *vanished])

    def attach(self, people: People, bodies: Detections2D, joints: JointSet) -> People:
        """Add the fingers of detections to people of either method; see ``pipeline.association.hands.attach``.

        ``bodies`` are the bodies of all cameras that ``gather`` gives, with all joints of the detections.
        """
        setting = self.cameras, joints, self.timebase, self._min_score
        return attach_hands(people, bodies, *setting, self._tracking.lambda_t_hz)

    @property
    def _tracking(self) -> TrackingParameters:
        return tracking_parameters(self.cameras, self.timebase, self.config.tracking)

    @property
    def _clustering(self) -> ClusteringParameters:
        return clustering_parameters(self.cameras, self.config, self.finds_fields)

    @property
    def _min_score(self) -> float:
        """Least score of observations that are used: clustering uses all of its own."""
        return 0.0 if self.config.method == "clustering" else self._tracking.min_score

    def _evidence(self, frames: range, detections: DetectionsByCamera) -> ViewEvidence:
        skeleton, parameters = clustering_skeleton(self.joints), self._clustering
        fields = {camera: value for camera, value in detections.items() if isinstance(value, PafFields)}
        if fields:
            return FieldEvidence(self.cameras, self.times, fields, self.timebase, skeleton, parameters)
        span = span_s(self.timebase, frames.start, frames.stop)
        bodies = {
            camera: value.within(frames_in(self.times[camera], *span))
            for camera, value in detections.items()
            if isinstance(value, Detections)
        }
        return BodyEvidence(self.cameras, self.times, bodies, self.timebase, skeleton, parameters)


def association_in(context: Context, session: Session) -> Association:
    """Association of the detections in the session of a task, whole or wanted, to people."""
    source = detection_source(context)
    joints, fields = without_hands(source.joints(session)), source.finds_fields
    return Association(session.cameras, session.times, session.timebase, joints, context.config, fields)


def gathered_bodies(context: Context) -> tuple[Detections2D, tuple[DamagedVideo, ...]]:
    """Bodies of all cameras as tracking takes them, and the damaged videos among those that show them."""
    session, source = wanted_frames(context, context.session()), detection_source(context)
    bodies = source.bodies(session, with_colours=source.measures_colours)
    damaged = source.damaged_videos(session, [(name, seen.damaged, seen.changes) for name, seen in bodies.items()])
    return gather(session.cameras, session.times, bodies), damaged
