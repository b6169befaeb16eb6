"""Measured work of a unit of each stage, from which the time left of a job is foreseen. Standard library only."""

from collections.abc import Mapping

from pipeline.core.options.config import JointsOfBody, Profile, ReconstructionConfig
from pipeline.run.engine import stage

CAMERA_FRAME_S: Mapping[tuple[Profile, JointsOfBody], float] = {
    ("fast", "body"): 0.023,
    ("fast", "feet"): 0.054,
    ("balanced", "feet"): 0.063,
    ("balanced", "whole"): 0.100,
    ("accurate", "feet"): 0.151,
}
"""Seconds of a job a camera's frame on one core, by profile and joints: docs/lab/measurements.md, "Profiles"."""

# Seconds of a unit of the sample on one core: two people before four cameras. Other stages take about the last one.
_UNIT_S = {
    stage.LOOK: 0.03,
    stage.CHECK: 0.08,
    stage.ASSOCIATE: 0.015,
    stage.EXPECT: 0.004,
    stage.REDETECT: 0.014,
    stage.FIT: 0.09,
    stage.HOLD: 0.02,
}
_OTHER_UNIT_S = 0.03


def unit_s(stage_name: str, config: ReconstructionConfig) -> float:
    """Seconds that a unit of a stage takes on one core.

    >>> unit_s("detect", ReconstructionConfig(profile="fast", joints="body"))
    0.023
    """
    if stage_name == stage.DETECT:
        return CAMERA_FRAME_S.get((config.profile, config.detected_joints), CAMERA_FRAME_S["balanced", "feet"])
    return _UNIT_S.get(stage_name, _OTHER_UNIT_S)
