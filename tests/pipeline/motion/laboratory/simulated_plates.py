"""Simulated force plates under simulated people: forces by Newton's law from the true centre of mass."""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.laboratory.c3d_content import C3dHeader
from pipeline.capture.points import SessionMaker
from pipeline.core.data.laboratory import Laboratory
from pipeline.core.data.reconstruction import Subject
from pipeline.core.data.rigid import Rigid3
from pipeline.export.writers.c3d_file import header_bytes, parameter_bytes
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.balance.segment_masses import segment_masses
from pipeline.validation.simulation.motion.performance import joints_at
from tests.pipeline.motion.gait.walks import Act, performed
from tests.pipeline.motion.skeleton.observed import observe, ring_of

RATE_HZ, PER_FRAME = 100.0, 10
SAMPLE_HZ = RATE_HZ * PER_FRAME
MASS_KG = 71.0
# Steps of a converter of 16 bits.
NEWTONS, NEWTON_MILLIMETRES = 0.1, 50.0
FLOOR = ((-0.3, 0.3), (0.3, 0.9), (-0.9, -0.3))
LABELS = tuple(f"{quantity}{number}" for number in (1, 2, 3) for quantity in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"))


@cache
def true_motion(act: Act, lead_s: float, length_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of mass, its acceleration, and each foot's middle, at the samples of a file that begins at a time."""
    time_s = np.arange(round(length_s * SAMPLE_HZ)) / SAMPLE_HZ + lead_s
    joints_m = joints_at(performed(act), np.clip(time_s, 0.0, act.duration_s))
    masses = segment_masses(Subject(), act.joints)
    assert masses is not None
    centre_m = gaussian_filter1d(np.einsum("j,fjk->fk", masses.weights, joints_m), 15.0, axis=0, mode="nearest")
    acceleration = np.gradient(np.gradient(centre_m, axis=0), axis=0) * SAMPLE_HZ**2
    feet_m = np.stack(
        [joints_m[:, act.joints.indices((f"{side}_heel", f"{side}_big_toe"))].mean(1) for side in ("left", "right")]
    )
    return centre_m, acceleration, feet_m


def plates_m(act: Act, middles_m: tuple[tuple[float, float], ...], half_m: float = 0.3) -> np.ndarray:
    """Corners of plates with Z into the floor: clockwise from above."""
    corner = np.array([(1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, -1.0, 0.0), (-1.0, 1.0, 0.0)]) * half_m
    return np.stack([corner + np.array([x, y, 0.0]) for x, y in middles_m])


def simulated(act: Act, lead_s: float, length_s: float, corners_m: np.ndarray, seed: int = 0) -> Laboratory:
    """Laboratory whose first frame is at ``lead_s`` of the act; forces are the feet's, as many programs write them."""
    centre_m, acceleration, feet_m = true_motion(act, lead_s, length_s)
    total_n = MASS_KG * (acceleration + np.array([0.0, 0.0, GRAVITY_M_S2]))
    lift_m = feet_m[..., 2] - feet_m[..., 2].min()
    speed_m_s = np.linalg.norm(np.gradient(feet_m, axis=1), axis=-1) * SAMPLE_HZ
    down = (lift_m < 0.05) & (speed_m_s < 0.5)
    # Between two steps the lower foot carries, but in a jump no foot does.
    hop_m = performed(act).hop_m
    assert hop_m is not None
    if not hop_m.any():
        down |= ~down.any(0) & (lift_m == lift_m.min(0))
    # The nearer foot carries more.
    near = 1.0 / (0.02 + np.linalg.norm(feet_m[..., :2] - centre_m[:, :2], axis=-1))
    share = gaussian_filter1d(down * near, 8.0, axis=1)
    share = np.where(down.any(0), share / np.maximum(share.sum(0), 1e-9), 0.0) * (share > 0.0)
    rng = np.random.default_rng(seed)
    columns = []
    for corners in corners_m:
        middle_m, half_m = corners.mean(0), np.ptp(corners[:, 0]) / 2
        force_n, moment_nm = np.zeros((2, len(total_n), 3))
        for foot, carried in zip(feet_m, share, strict=True):
            on = (np.abs(foot[:, :2] - middle_m[:2]) < half_m).all(1)
            of_foot = total_n * (carried * on)[:, None]
            force_n += of_foot
            moment_nm += np.cross((foot - middle_m) * [1.0, 1.0, 0.0], of_foot)
        # Axes of the plate: X and Y as the corners say, Z down; the force of the foot is the opposite one.
        axes = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        columns += [-force_n @ axes.T / NEWTONS, -moment_nm @ axes.T * 1000.0 / NEWTON_MILLIMETRES]
    samples = np.concatenate(columns, axis=1)
    samples = np.round(samples + rng.normal(0.0, 3.0, samples.shape)).astype(np.float32)
    num_plates = len(corners_m)
    groups: dict[str, dict[str, Any]] = {
        "ANALOG": {
            "USED": np.array([6 * num_plates], "u2"),
            "LABELS": list(LABELS[: 6 * num_plates]),
            "UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * num_plates,
            "SCALE": np.array([NEWTONS, NEWTONS, NEWTONS, *[NEWTON_MILLIMETRES] * 3] * num_plates, "f4"),
            "OFFSET": np.zeros(6 * num_plates, "u2"),
            "GEN_SCALE": np.array([1.0], "f4"),
            "RATE": np.array([SAMPLE_HZ], "f4"),
        },
        "FORCE_PLATFORM": {
            "USED": np.array([num_plates], "u2"),
            "TYPE": np.full(num_plates, 2, "u2"),
            "ZERO": np.array([1, 0], "u2"),
            "CORNERS": (corners_m * 1000.0).astype("f4"),
            "ORIGIN": np.zeros((num_plates, 3), "f4"),
            "CHANNEL": np.arange(1, 6 * num_plates + 1, dtype="u2").reshape(num_plates, 6),
        },
    }
    world = Rigid3(np.eye(3), np.zeros(3))
    num_frames = len(samples) // PER_FRAME
    return Laboratory("trial.c3d", "mm", RATE_HZ, num_frames, PER_FRAME, samples, groups, (), world)


def c3d_bytes(
    laboratory: Laboratory,
    more: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    *,
    kind: str = "<i2",
    first_frame: int = 1,
) -> bytes:
    """C3D file of a laboratory without points, with integers or floats, and further parameters."""
    last_frame = first_frame + laboratory.num_frames - 1
    point = {
        "USED": [0],
        "FRAMES": [laboratory.num_frames],
        "SCALE": [-1.0 if kind == "<f4" else 1.0],
        "RATE": [laboratory.frame_rate_hz],
        "DATA_START": [0],
        "LABELS": [],
        "UNITS": [laboratory.unit],
    }
    groups: dict[str, Mapping[str, Any]] = {"POINT": point, **laboratory.groups}
    for name, added in more.items():
        groups[name] = {**groups.get(name, {}), **added}
    parameters = parameter_bytes(groups)
    first_block = 2 + len(parameters) // 512
    per_frame = laboratory.samples_per_frame
    scale = -1.0 if kind == "<f4" else 1.0
    facts = 0, per_frame * laboratory.samples.shape[1], first_frame, last_frame, scale, first_block, per_frame
    header = header_bytes(C3dHeader(*facts, laboratory.frame_rate_hz))
    stored = (
        laboratory.samples.astype(np.int64).astype(kind).tobytes()
        if kind != "<f4"
        else (laboratory.samples.astype(kind).tobytes())
    )
    return header + parameters + stored + bytes(-len(stored) % 512)


def recorded(act: Act) -> KeypointSession:
    """Session of the keypoints that the cameras of an act see."""
    time_s = np.arange(0.0, act.duration_s, 1.0 / act.rate_hz)
    cameras = ring_of(act.num_cameras)
    _, seen = observe(cameras, joints_at(performed(act), time_s), noise_px=act.noise_px, seed=act.seed)
    keypoints_px = np.moveaxis(seen.points_px, 1, 0)
    return SessionMaker.from_arrays(keypoints_px, None, cameras, act.rate_hz, joints=act.joints.names)
