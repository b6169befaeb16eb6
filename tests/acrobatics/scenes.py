"""Scenes of people who perform an acrobatic motion once, and stay in its last pose."""

from functools import partial

import numpy as np

from pipeline.core.joints import JointSet
from pipeline.validation.simulation.rigs import Clock, Layout, Rig
from pipeline.validation.simulation.scenes import SCENES, JointsAt, Scene, SegmentsAt
from pipeline.validation.simulation.views.detector import DetectorAccuracy
from pipeline.validation.simulation.views.faults import NO_FAULTS
from tests.acrobatics.acrobat import acrobat_joints_at, acrobat_segments_at, perform_acrobatics
from tests.acrobatics.motions import ACROBATICS


def _act(
    motion: str, duration_s: float, seed: np.random.SeedSequence, joints: JointSet
) -> list[tuple[JointsAt, SegmentsAt]]:
    parts = ACROBATICS[motion]
    acrobats = (
        perform_acrobatics(
            part.keys, part.center_m, float(np.radians(part.facing_deg)), duration_s, np.random.default_rng(person_seed)
        )
        for part, person_seed in zip(parts, seed.spawn(len(parts)), strict=True)
    )
    return [
        (partial(acrobat_joints_at, acrobat, joints=joints), partial(acrobat_segments_at, acrobat))
        for acrobat in acrobats
    ]


def _scene(motion: str) -> Scene:
    last_s = max(part.keys[-1].time_s for part in ACROBATICS[motion])
    return Scene(
        Rig(Layout.RING, 6, (4.0, 4.0), 2.2, focal_px=760.0, target_height_m=0.9),
        partial(_act, motion),
        Clock(30.0),
        DetectorAccuracy(noise_m=0.0, noise_px=2.5, faults=NO_FAULTS),
        # At the slowest tempo.
        duration_s=round(1.2 * last_s, 1),
    )


ACROBATIC_SCENES = {motion: _scene(motion) for motion in ACROBATICS}
ALL_SCENES = {**SCENES, **ACROBATIC_SCENES}
