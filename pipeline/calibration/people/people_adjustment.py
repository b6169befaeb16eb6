"""Bundle adjustment of cameras and joints: bones of constant length, plausible speeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.adjustment import parameters
from pipeline.calibration.adjustment import problem as problems
from pipeline.calibration.adjustment.bundle import Adjustment, adjust
from pipeline.calibration.adjustment.lasting_errors import lasting_covariance
from pipeline.calibration.people.bodies import MatchedBodies
from pipeline.calibration.people.following import JOINTS
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project

# Metric in which cameras hold the world: a turn and a shift that count as much.
_TURN_RAD, _SHIFT_M = np.radians(0.3), 0.02


def correlated_sigma(
    problem: problems.AdjustmentProblem, adjusted: Adjustment, levels: Sequence[Int[np.ndarray, " n"]]
) -> parameters.Parameters:
    """Compute standard deviations of the cameras' parameters, each camera's in the world that the others hold.

    ``problem``, ``adjusted``: an adjustment of free points without deviations, of which some extrinsics hold the world.
    ``levels``: number of the subject of each observation, such as a joint of a person, of nested levels: coarse ones
    first. A camera's observations of a subject have a common error. Returns standard deviations: 0 where a parameter
    other than extrinsics was not free. Extrinsics have the covariance of the errors that are left after the similarity
    that fits the other cameras best.
    """
    reduced, spread = lasting_covariance(problem, adjusted, levels)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(reduced), np.finfo(float).tiny))
    inverse = scale[:, None] * np.linalg.pinv(scale[:, None] * reduced * scale, hermitian=True) * scale
    return _beside_others(problem, adjusted, inverse @ spread @ inverse)


def _beside_others(
    problem: problems.AdjustmentProblem, adjusted: Adjustment, covariance: Float[np.ndarray, "parameters parameters"]
) -> parameters.Parameters:
    """Standard deviations of each camera after the move of the world that changes the other cameras least.

    Of two cameras both hold the world: one alone does not tell its scale.
    """
    free = problem.free
    num_cameras = len(free)
    whole = np.zeros((free.size, free.size))
    rows = np.flatnonzero(free)
    whole[np.ix_(rows, rows)] = covariance
    moves = parameters.world_moves(adjusted.cameras)
    metric = np.zeros(parameters.NUM_PARAMETERS)
    metric[parameters.ROTATION], metric[parameters.POSITION] = _TURN_RAD**-2.0, _SHIFT_M**-2.0
    sigma = np.zeros(free.shape)
    for number in range(num_cameras):
        holds = np.ones(num_cameras)
        if num_cameras > 2:
            holds[number] = 0.0
        weighted = (moves * metric[:, None] * holds[:, None, None]).reshape(free.size, -1)
        back = moves[number] @ np.linalg.solve(weighted.T @ moves.reshape(free.size, -1), weighted.T)
        change = -back
        change[:, number * parameters.NUM_PARAMETERS : (number + 1) * parameters.NUM_PARAMETERS] += np.eye(
            parameters.NUM_PARAMETERS
        )
        sigma[number] = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", change, whole, change), 0.0))
    sigma[:, parameters.EXTRINSICS.stop :][~free[:, parameters.EXTRINSICS.stop :]] = 0.0
    return read_only(sigma)


_BONES = tuple(
    (JOINTS.index(begin), JOINTS.index(end))
    for side in ("left", "right")
    for begin, end in (
        (f"{side}_shoulder", f"{side}_elbow"),
        (f"{side}_elbow", f"{side}_wrist"),
        (f"{side}_hip", f"{side}_knee"),
        (f"{side}_knee", f"{side}_ankle"),
    )
) + tuple((JOINTS.index(f"left_{kind}"), JOINTS.index(f"right_{kind}")) for kind in ("shoulder", "hip"))
# Standard deviations: of a bone's length, for detectors mark joints differently from side to side; of a joint's speed.
_BONE_SIGMA_M, _SPEED_SIGMA_M_S = 0.02, 2.0
# Bodies that an adjustment takes, of a first search and of the last one, and groups whose bones are measured.
_FEW_BODIES, _MANY_BODIES, _MAX_GROUPS = 120, 500, 24
_MIN_GROUP = 10
# Observations farther from the projection than this share of the focal length are of another person.
_MAX_ERROR = 0.03
# Time for which an error of a detector lasts, beside those that last for the whole take.
_LASTING_S = 1.0
# Largest number of steps of a search, and the step that ends it: of angles in radians, of positions in distances of two
# cameras, of logarithms of focal lengths, and of coefficients. The rest would gain a hundredth of the standard
# deviations.
_MAX_STEPS, _SMALL_STEP = 30, 3e-6
# Priors where intrinsics are guessed: logarithm of the focal length, first radial coefficient.
_FOCAL_SIGMA, _K1_SIGMA = 0.25, 0.15


@dataclass(frozen=True, slots=True, eq=False)
class PeopleFit:
    """Adjusted cameras."""

    cameras: tuple[Camera, ...]  # Cameras; the world is the one they came with
    sigma: parameters.Parameters  # Standard deviations of their parameters
    error_px: Float[np.ndarray, " cameras"]  # Median distance of each camera's projections from the observations
    fitting: Float[np.ndarray, " cameras"]  # Share of each camera's observations that fit the other cameras


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Adjustment of cameras to bodies, with the body and the joint of each observation."""

    problem: problems.AdjustmentProblem
    adjusted: Adjustment
    body: Int[np.ndarray, " observations"]
    joint: Int[np.ndarray, " observations"]
    fitting: Float[np.ndarray, " cameras"]  # See ``PeopleFit``


def adjust_poses(posed: Mapping[int, Camera], bodies: MatchedBodies, has_free_lenses: bool) -> dict[int, Camera]:
    """Adjust the cameras that are posed so far to some bodies."""
    numbers = sorted(posed)
    chosen = _spread(bodies.in_cameras(numbers), _FEW_BODIES)
    fit = _adjust([posed[k] for k in numbers], chosen, None, has_free_lenses and len(numbers) > 2)
    return dict(zip(numbers, fit.adjusted.cameras, strict=True))


def adjust_people_rig(
    cameras: Sequence[Camera], bodies: MatchedBodies, instants_s: Float[np.ndarray, " instants"], has_free_lenses: bool
) -> PeopleFit:
    """Adjust all cameras to bodies all over the take, with bones and speeds.

    ``has_free_lenses``: focal lengths and first radial coefficients are adjusted too.
    """
    chosen = _spread(bodies, _MANY_BODIES)
    fit = _adjust(cameras, chosen, instants_s, has_free_lenses)
    part = (instants_s[chosen.instant[fit.body]] - instants_s[0]) // _LASTING_S
    whole = chosen.group[fit.body] * len(JOINTS) + fit.joint
    sigma = correlated_sigma(fit.problem, fit.adjusted, [whole, whole * len(instants_s) + part.astype(int)])
    error_px = fit.adjusted.error_px(fit.problem.observations.camera)
    return PeopleFit(fit.adjusted.cameras, sigma, error_px, fit.fitting)


def _spread(bodies: MatchedBodies, most: int) -> MatchedBodies:
    """Bodies at pairs of neighbouring instants all over the take."""
    step = max(1, -(-len(bodies) // most))
    return bodies.subset(np.flatnonzero((bodies.instant // 2) % step == 0))


def _adjust(
    cameras: Sequence[Camera],
    bodies: MatchedBodies,
    instants_s: Float[np.ndarray, " instants"] | None,
    has_free_lenses: bool,
) -> _Fit:
    xyz_m = bodies.triangulated(cameras)
    projected_px = np.stack([project(camera, xyz_m) for camera in cameras], axis=1)
    focal_px = np.array([camera.matrix[0, 0] for camera in cameras])[:, None]
    error = np.linalg.norm(projected_px - bodies.points_px, axis=-1) / focal_px
    fits = error < _MAX_ERROR
    is_known = np.isfinite(xyz_m).all(-1) & (fits.sum(1) >= 2)
    number = np.full(is_known.shape, -1)
    number[is_known] = np.arange(is_known.sum())
    body, camera, joint = np.nonzero(fits & is_known[:, None])
    observations = problems.PointObservations(
        camera, number[body, joint], np.zeros((len(camera), 3)), bodies.points_px[body, camera, joint]
    )
    links, lengths_m = _links(bodies, number, xyz_m, instants_s) if instants_s is not None else ((), np.empty(0))
    free, sigma = parameters.none_free(len(cameras)), parameters.no_prior(len(cameras))
    free[1:, parameters.EXTRINSICS] = True
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    # The scale is fixed by one coordinate of the camera that is farthest from the first one.
    farthest = int(np.argmax(np.linalg.norm(centers_m - centers_m[0], axis=-1)))
    along = int(np.argmax(np.abs(centers_m[farthest] - centers_m[0])))
    free[farthest, parameters.POSITION.start + along] = False
    if has_free_lenses:
        free[:, parameters.FOCAL] = True
        free[:, parameters.DISTORTION.start] = True
        sigma[:, parameters.FOCAL], sigma[:, parameters.DISTORTION.start] = _FOCAL_SIGMA, _K1_SIGMA
    problem = problems.AdjustmentProblem(
        tuple(cameras), free, sigma, observations, problems.Loss.CAUCHY, links, read_only(lengths_m),
        read_only(np.full(len(lengths_m), np.inf)),
    )  # fmt: skip
    small_step = np.full_like(sigma, _SMALL_STEP)
    points = problems.FreePoints(read_only(xyz_m[is_known]))
    adjusted = adjust(problem, points, max_steps=_MAX_STEPS, small_step=small_step)
    num_seen = (bodies.seen() & np.isfinite(xyz_m).all(-1)[:, None]).sum((0, 2))
    fitting = read_only(np.bincount(camera, minlength=len(cameras)) / np.maximum(num_seen, 1))
    return _Fit(problem, adjusted, body, joint, fitting)


def _links(
    bodies: MatchedBodies,
    number: Int[np.ndarray, "n joints"],
    xyz_m: Float[np.ndarray, "n joints 3"],
    instants_s: Float[np.ndarray, " instants"],
) -> tuple[tuple[problems.PointLink, ...], Float[np.ndarray, " lengths"]]:
    """Bones of the groups that are seen most, and shifts between neighbouring instants."""
    groups, counts = np.unique(bodies.group, return_counts=True)
    order = np.argsort(-counts)[:_MAX_GROUPS]
    pairs, owners = [], []
    lengths_m: list[float] = []
    for group in groups[order][counts[order] >= _MIN_GROUP]:
        own = bodies.group == group
        for begin, end in _BONES:
            rows = own & (number[:, [begin, end]] >= 0).all(-1)
            if rows.sum() < _MIN_GROUP:
                continue
            pairs.append(number[rows][:, [begin, end]])
            owners.append(np.full(rows.sum(), len(lengths_m)))
            lengths_m.append(float(np.median(np.linalg.norm(xyz_m[rows, begin] - xyz_m[rows, end], axis=-1))))
    follows = (bodies.group[1:] == bodies.group[:-1]) & (bodies.instant[1:] == bodies.instant[:-1] + 1)
    before, after = number[:-1][follows], number[1:][follows]
    both = (before >= 0) & (after >= 0)
    step_s = float(instants_s[1] - instants_s[0])
    shifts = problems.ShiftLinks(
        np.column_stack([before[both], after[both]]), np.full(both.sum(), _SPEED_SIGMA_M_S * step_s)
    )
    if not pairs:
        return (shifts,), np.empty(0)
    bones = np.concatenate(pairs)
    distances = problems.DistanceLinks(bones, np.concatenate(owners), np.full(len(bones), _BONE_SIGMA_M))
    return (distances, shifts), np.array(lengths_m)
