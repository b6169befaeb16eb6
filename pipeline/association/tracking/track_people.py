"""Cross-view tracking of a session: association of detections in time order, then triangulation of every person."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.tracking import observations
from pipeline.association.tracking.kernels.observation_kernels import Sampling, locate, record
from pipeline.association.tracking.tracker import Tracker, make_frames
from pipeline.association.tracking.tracking_parameters import TrackingParameters
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Leftovers, Observations, People, Track3D
from pipeline.core.progress import OnShare, ignore, sub_share
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.camera_kernels import make_lenses
from pipeline.geometry.kernels import make_solver
from pipeline.geometry.track_assembly import close_gaps, find_life, make_person, number_people


def assign_detections(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, Int[np.ndarray, " _"]]:
    """Assign detections to people (Chen et al. 2020, algorithm 1).

    ``cameras``: calibrated cameras, in any order. ``times``, ``detections``: times of the frames in seconds, and bodies
    in distorted pixels, by name of the camera. Joints are NaN where the detector found none. Cameras need not be
    synchronised. ``parameters``: parameters of ``derive_parameters``. Returns identity of each detection by name of the
    camera; ``UNASSIGNED`` if it belongs to no target, or to a target that was never confirmed.
    """
    bodies = observations.gather(cameras, times, detections)
    identity = _identify(cameras, times, bodies, observations.undistorted(cameras, bodies), parameters, ignore, ignore)
    return {camera.name: identity[bodies.camera == number] for number, camera in enumerate(cameras)}


def locate_people(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    identities: Mapping[str, Int[np.ndarray, " _"]],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> People:
    """Triangulate every person at the output frames from all detections of the person's identity.

    Joints are located by weighted incremental triangulation (Chen et al. 2020, eq. 10-11), robust against single views.

    ``cameras``, ``times``, ``detections``, ``parameters``: see ``assign_detections``. ``identities``: result of
    ``assign_detections``. ``timebase``: output frames. Returns tracks, numbered from 1 in order of their first frame,
    with joints in metres, NaN where a joint is absent; the observations behind each of them; and the bodies that are
    left.
    """
    bodies = observations.gather(cameras, times, detections)
    identity = np.concatenate([identities[camera.name] for camera in cameras])
    samplings = _samplings(cameras, bodies, identity, timebase, parameters)
    xyz_m = _triangulate(cameras, bodies, observations.undistorted(cameras, bodies), samplings, parameters, ignore)
    return _record(cameras, bodies, samplings, xyz_m, timebase, parameters, ignore)


def reconstruct_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Associate detections, then locate every person; see ``assign_detections`` and ``locate_people``.

    Parameters
    ----------
    times, detections
        Times of the frames in seconds, and bodies in distorted pixels, by name of the camera.
    timebase
        Output frames.
    parameters
        Parameters of the tracker, such as ``derive_parameters`` gives.

    Returns
    -------
        Tracks with joints (frames, joints, 3) in metres, and observations with pixels (frames, cameras, joints, 2), in
        the same order; NaN where unknown.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pipeline.association.tracking.tracking_parameters import derive_parameters
    >>> from pipeline.validation.simulation.scenes import SCENES, record
    >>> take = record(replace(SCENES["room"], duration_s=2.0), seed=0)
    >>> parameters = derive_parameters(take.cameras, take.timebase.frame_rate_hz)
    >>> tracks, observations = reconstruct_tracks(
    ...     take.cameras, take.times, take.detections, take.timebase, parameters
    ... )
    >>> [track.track_id for track in tracks]
    [1, 2, 3]
    """
    people = track_bodies(cameras, times, observations.gather(cameras, times, detections), timebase, parameters)
    return tuple(people.tracks), tuple(people.observations)


def track_bodies(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: observations.Detections2D,
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare = ignore,
    on_approximate: Callable[[float], object] = ignore,
) -> People:
    """Associate gathered detections, then locate every person; the detections themselves may have been freed.

    - ``cameras``, ``times``, ``timebase``, ``parameters``: see ``assign_detections`` and ``locate_people``.
    - ``bodies``: detections of all cameras in one record; see ``observations.gather``.
    - ``on_share``: called with the completed share of the work, of which association is a half.
    - ``on_approximate``: called with the time in seconds of each frame that exceeds a limit of the exact method.
    - Returns people; see ``locate_people``.
    """
    ideal_px = observations.undistorted(cameras, bodies)
    identity = _identify(cameras, times, bodies, ideal_px, parameters, sub_share(on_share, 0.0, 0.5), on_approximate)
    samplings = _samplings(cameras, bodies, identity, timebase, parameters)
    xyz_m = _triangulate(cameras, bodies, ideal_px, samplings, parameters, sub_share(on_share, 0.5, 0.75))
    del ideal_px
    return _record(cameras, bodies, samplings, xyz_m, timebase, parameters, sub_share(on_share, 0.75, 1.0))


def _identify(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    bodies: observations.Detections2D,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    parameters: TrackingParameters,
    on_share: OnShare,
    on_approximate: Callable[[float], object],
) -> Int[np.ndarray, " detections"]:
    """Run the tracker; see ``assign_detections``."""
    frames = make_frames([times[camera.name] for camera in cameras], bodies, ideal_px, parameters.min_score)
    return Tracker(cameras, frames, parameters).run(on_share, on_approximate)


def _samplings(
    cameras: Sequence[Camera],
    bodies: observations.Detections2D,
    identity: Int[np.ndarray, " detections"],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> list[Sampling]:
    return [
        observations.make_sampling(timebase, bodies, rows, len(cameras), parameters.lambda_t_hz)
        for rows in observations.rows_by_person(bodies, identity)
    ]


def _triangulate(
    cameras: Sequence[Camera],
    bodies: observations.Detections2D,
    ideal_px: Float[np.ndarray, "detections joints 2"],
    samplings: Sequence[Sampling],
    parameters: TrackingParameters,
    on_share: OnShare,
) -> list[Float[np.ndarray, "_ joints 3"]]:
    """Triangulate each person at the output instants, robustly."""
    num_joints = bodies.score.shape[1]
    solver = make_solver(projection_matrices(cameras), parameters.min_score)
    flat_px = ideal_px.reshape(len(ideal_px), 2 * num_joints)
    room = np.empty((len(cameras), 2 * num_joints)), np.empty((len(cameras), num_joints))

    def located_m(sampling: Sampling) -> Float[np.ndarray, "frames joints 3"]:
        shape = len(sampling.instants_s), num_joints
        xyz_m, guess_m = (large_arrays.empty((*shape, 3)) for _ in range(2))
        disputed = np.empty(shape, bool)
        locate(sampling, bodies, flat_px, solver, *room, xyz_m, disputed, guess_m)
        return xyz_m

    return [located_m(sampling) for sampling in _reported(samplings, on_share)]


def _record(
    cameras: Sequence[Camera],
    bodies: observations.Detections2D,
    samplings: Sequence[Sampling],
    xyz_m: Sequence[Float[np.ndarray, "_ joints 3"]],
    timebase: Timebase,
    parameters: TrackingParameters,
    on_share: OnShare,
) -> People:
    """Make each person's track, and the observations behind it in distorted pixels."""
    num_cameras, num_joints = len(cameras), bodies.score.shape[1]
    lenses = make_lenses(cameras, parameters.min_score)
    lives = [find_life(timebase, person_m) for person_m in xyz_m]
    # One array for all people: its memory consists of larger pages, and its first use takes a fifth of the time.
    num_frames = sum(life.stop - life.start for life in lives if life is not None)
    seen_px = large_arrays.empty((num_frames, num_cameras, num_joints, 2))
    score = large_arrays.empty((num_frames, num_cameras, num_joints))
    flat_px = (
        bodies.seen_px.reshape(len(bodies.seen_px), 2 * num_joints),
        seen_px.reshape(num_frames, num_cameras, 2 * num_joints),
    )
    recorded, num_done = [], 0
    is_left = np.ones(len(bodies.camera), bool)
    for sampling, whole_m, life in zip(_reported(samplings, on_share), xyz_m, lives, strict=True):
        if life is None:
            continue
        person_m, sampled = whole_m[life], observations.sampled_in(life, sampling)
        source = close_gaps(timebase, person_m)
        ours = slice(num_done, num_done + len(person_m))
        error_px, mean_score = (large_arrays.empty(source.shape) for _ in range(2))
        errors = error_px, mean_score, large_arrays.empty(source.shape, np.int64)
        record(sampled, bodies, flat_px[0], lenses, person_m, flat_px[1][ours], score[ours], *errors)
        detection = observations.detections_at(timebase, bodies, sampled) if bodies.colour.size else None
        recorded.append(
            make_person(sampled.start_frame, person_m, source, errors, seen_px[ours], score[ours], detection)
        )
        is_left[_rows_within(sampling, sampled.start_frame, len(person_m), timebase)] = False
        num_done += len(person_m)
    return People(*number_people(recorded), leftovers=_leftovers(bodies, np.flatnonzero(is_left), timebase))


def _rows_within(sampling: Sampling, start_frame: int, num_frames: int, timebase: Timebase) -> Int[np.ndarray, " rows"]:
    """Rows of a person's detections in the person's life; one camera alone may have more before and behind."""
    place = (sampling.seen_s - timebase.start_time_s) * timebase.frame_rate_hz - start_frame
    return np.asarray(sampling.rows[(place > -1.0) & (place < num_frames)])


def _leftovers(bodies: observations.Detections2D, rows: Int[np.ndarray, " n"], timebase: Timebase) -> Leftovers:
    place = (bodies.time_s[rows] - timebase.start_time_s) * timebase.frame_rate_hz
    frame = np.round(place).astype(int)
    inside = (frame >= 0) & (frame < timebase.num_frames)
    rows, frame = rows[inside], frame[inside]
    return Leftovers(frame, bodies.camera[rows], bodies.seen_px[rows], bodies.score[rows])


def _reported(samplings: Sequence[Sampling], on_share: OnShare) -> Iterator[Sampling]:
    """Yield each person's sampling, and report the share of all detections after each person."""
    num_all, num_done = sum(len(sampling.rows) for sampling in samplings), 0
    for sampling in samplings:
        yield sampling
        num_done += len(sampling.rows)
        on_share(num_done / num_all)
