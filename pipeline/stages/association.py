"""Association: steps of both methods from detections in a session to tracks.

``tracking`` is one sequential pass. ``clustering`` first measures everybody's bones over the whole session, then finds
people in each range of frames by itself, and then links them. At last a global pass over either method's tracks finds
out who is who. Detections are whole bodies (``Detections``) or peaks
and fields (``PafFields``), at least those of the range.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.capture.session import Session
from pipeline.clustering.associate import find_people, first_lengths, join_poses, link_people, sampled_frames
from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.clustering.instant.candidates import BodyEvidence, FieldEvidence, ViewEvidence
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.parameters import derive_parameters as derive_clustering
from pipeline.clustering.skeleton import skeleton_of
from pipeline.config import ReconstructionConfig, networks_of
from pipeline.data.detections import DamagedVideo, Detections, DetectionsByCamera, PafFields
from pipeline.data.people import Leftovers, People, Poses3D
from pipeline.detect.chunk import concatenate
from pipeline.detect.entries import entry_of
from pipeline.hands.attach import attach_hands
from pipeline.identity.alone import follow_alone
from pipeline.identity.identify import identify
from pipeline.identity.neighbours.decide import return_limbs
from pipeline.identity.sides.decide import decide_sides
from pipeline.joints import JointSet
from pipeline.parameters import change_parameters
from pipeline.progress import OnShare, ignore
from pipeline.redetection.accept import accept
from pipeline.tracking.associate import track_bodies
from pipeline.tracking.observations import Detections2D
from pipeline.tracking.parameters import TrackingParameters
from pipeline.tracking.parameters import derive_parameters as derive_tracking
from pipeline.video.timeline import frames_in, num_recorded, span_s

_DEFAULTS = ReconstructionConfig()


class MeasuredBones(NamedTuple):
    """Everybody's bone lengths, and the damaged videos among those that they were measured in."""

    lengths: LimbLengths
    damaged: tuple[DamagedVideo, ...]


def tracking_parameters(session: Session, changes: Mapping[str, float] = MappingProxyType({})) -> TrackingParameters:
    """Derive the tracker's parameters from the session, with changes by name.

    A person in a session of fewer than ``confirm_instants`` frames is confirmed by all of them. Raises ``InputError``
    if a changed parameter does not exist, or can't have that value.
    """
    derived = derive_tracking(session.cameras, session.timebase.frame_rate_hz)
    confirm_instants = min(derived.confirm_instants, session.timebase.num_frames)
    return change_parameters(replace(derived, confirm_instants=confirm_instants), changes)


def clustering_parameters(session: Session, config: ReconstructionConfig) -> ClusteringParameters:
    """Derive the parameters of clustering from the session and the detector, with the configuration's changes.

    Raises ``InputError`` if a changed parameter does not exist, or can't have that value.
    """
    fields = entry_of(networks_of(config).body).fields if config.uses_fields and session.video_of else None
    own = {} if fields is None else {"tau2": fields.tau2}
    return change_parameters(derive_clustering(session.cameras, **own), config.clustering)


def track(
    session: Session, bodies: Detections2D, config: ReconstructionConfig = _DEFAULTS, on_share: OnShare = ignore
) -> People:
    """Track people by cross-view tracking: one pass in time order.

    ``bodies`` are those of all cameras, as of ``gather``; the detections of the session are not read.
    """
    parameters = tracking_parameters(session, config.tracking)
    timebase = session.timebase
    approximate: set[int] = set()
    people = track_bodies(
        session.cameras,
        session.times,
        bodies,
        timebase,
        parameters,
        on_share,
        lambda time_s: approximate.add(round((time_s - timebase.start_time_s) * timebase.frame_rate_hz)),
    )
    return people._replace(num_approximate_frames=len(approximate))


def measure_bones(
    session: Session,
    chunks: Iterable[tuple[range, DetectionsByCamera]],
    joints: JointSet,
    config: ReconstructionConfig,
    on_frame: Callable[[], None] = lambda: None,
) -> LimbLengths:
    """Measure the bones of all people in a first pass over frames all over the session.

    ``chunks`` are ranges of output frames in order of time, with their detections; read one at a time.
    """
    parameters = clustering_parameters(session, config)
    sampled = sampled_frames(session.timebase, parameters)
    evidence = (
        (_evidence(session, frames, detections, joints, parameters), [frame for frame in frames if frame in sampled])
        for frames, detections in chunks
    )
    return first_lengths(session.cameras, evidence, session.timebase, skeleton_of(joints), parameters, on_frame)


def locate_people(
    session: Session,
    frames: range,
    detections: DetectionsByCamera,
    lengths: LimbLengths,
    joints: JointSet,
    config: ReconstructionConfig,
    on_frame: Callable[[], None] = lambda: None,
) -> Poses3D:
    """Find all people in a range of output frames; the result does not depend on the cut into ranges."""
    parameters = clustering_parameters(session, config)
    evidence = _evidence(session, frames, detections, joints, parameters)
    return find_people(session.cameras, evidence, frames, skeleton_of(joints), lengths, parameters, on_frame)


def link(
    session: Session,
    chunks: Iterable[Poses3D],
    joints: JointSet,
    config: ReconstructionConfig,
    on_share: OnShare = ignore,
) -> People:
    """Link the poses of all ranges to tracks."""
    parameters = clustering_parameters(session, config)
    poses = join_poses(chunks)
    people = link_people(session.cameras, poses, session.timebase, joints, parameters, on_share)
    return People(*people, len(poses.approximate))


def assign_identities(
    session: Session,
    people: People,
    joints: JointSet,
    config: ReconstructionConfig,
    colour: UInt8[np.ndarray, "detections parts bins"] | None = None,
) -> People:
    """Find out who is who among the tracks of either method; see ``pipeline.identity.identify``."""
    min_score = _min_score(session, config)
    recorded = num_recorded(session.timebase, (times.time_s for times in session.times.values()))
    return identify(people, session.cameras, joints, session.timebase, min_score, config.num_people, colour, recorded)


def accept_redetected(
    session: Session, people: People, found: Iterable[Detections], joints: JointSet, config: ReconstructionConfig
) -> People:
    """Give people the bodies that were detected again; see ``pipeline.redetection.accept``.

    ``found`` are those of ranges and cameras, those of a camera in order of time.
    """
    bodies = concatenate(found, [camera.name for camera in session.cameras], len(joints.names))
    lambda_t_hz = tracking_parameters(session, config.tracking).lambda_t_hz
    cameras = session.cameras, session.times, session.timebase
    return accept(people, bodies, *cameras, joints, _min_score(session, config), lambda_t_hz)


def assign_limbs(session: Session, people: People, joints: JointSet, config: ReconstructionConfig) -> People:
    """Give each limb one person and one side; see ``pipeline.identity.neighbours`` and ``pipeline.identity.sides``."""
    setting = session.cameras, session.timebase, joints, _min_score(session, config)
    persons = return_limbs(list(zip(people.tracks, people.observations, strict=True)), *setting)
    sided = [decide_sides(person, *setting) for person in persons]
    numbers = [track.track_id for track in people.tracks]
    return people._replace(
        tracks=tuple(replace(track, track_id=k) for (track, _), k in zip(sided, numbers, strict=True)),
        observations=tuple(replace(seen, track_id=k) for (_, seen), k in zip(sided, numbers, strict=True)),
    )


def follow_by_one_camera(
    session: Session, people: People, left: Leftovers | None, config: ReconstructionConfig
) -> People:
    """Continue people whom one camera alone still sees; see ``pipeline.identity.alone``.

    ``left`` are the bodies that association gave to nobody; ``None`` where it takes joints one by one.
    """
    if left is None:
        return people
    persons = list(zip(people.tracks, people.observations, strict=True))
    followed = follow_alone(persons, left, session.cameras, session.timebase, _min_score(session, config))
    return people._replace(
        tracks=tuple(track for track, _ in followed), observations=tuple(seen for _, seen in followed)
    )


def attach(
    session: Session, people: People, bodies: Detections2D, joints: JointSet, config: ReconstructionConfig
) -> People:
    """Add the fingers of detections to people of either method; see ``pipeline.hands.attach``.

    People have the joints of ``without_hands(joints)``, bodies of all cameras all joints, as of ``gather``.
    """
    parameters, min_score = tracking_parameters(session, config.tracking), _min_score(session, config)
    return attach_hands(people, bodies, session.cameras, joints, session.timebase, min_score, parameters.lambda_t_hz)


def _min_score(session: Session, config: ReconstructionConfig) -> float:
    """Least score of observations that are used: clustering uses all of its own."""
    return 0.0 if config.method == "clustering" else tracking_parameters(session, config.tracking).min_score


def _evidence(
    session: Session, frames: range, detections: DetectionsByCamera, joints: JointSet, parameters: ClusteringParameters
) -> ViewEvidence:
    """Evidence in a range of output frames."""
    skeleton = skeleton_of(joints)
    fields = {camera: value for camera, value in detections.items() if isinstance(value, PafFields)}
    if fields:
        return FieldEvidence(session.cameras, session.times, fields, session.timebase, skeleton, parameters)
    span = span_s(session.timebase, frames.start, frames.stop)
    bodies = {
        camera: value.within(frames_in(session.times[camera], *span))
        for camera, value in detections.items()
        if isinstance(value, Detections)
    }
    return BodyEvidence(session.cameras, session.times, bodies, session.timebase, skeleton, parameters)
