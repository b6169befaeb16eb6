"""Time that is left of a job: right at any pace, with several workers, whatever its stages take a unit."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis.strategies import floats, integers

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.stage import ASSOCIATE, DETECT, FIT, LOOK
from pipeline.run.space import unit_s
from worker.store.database.rows import time_left_s
from worker.store.model.job_records import StageProgress
from worker.store.model.states import ChunkState

START = datetime(2026, 11, 30, tzinfo=UTC)
CONFIG = ReconstructionConfig(profile="accurate")
# Units and chunks of each stage.
STAGES: Mapping[str, tuple[int, int]] = {LOOK: (48, 4), DETECT: (4000, 40), ASSOCIATE: (100, 1), FIT: (120, 4)}


def simulated(pace: float, num_workers: int, share: float) -> tuple[list[StageProgress], datetime, float]:
    """Stages of a job as they are after a share of its time, that time, and the seconds that are left."""
    took_s = {
        name: pace * units * unit_s(name, CONFIG) / min(num_workers, num_chunks)
        for name, (units, num_chunks) in STAGES.items()
    }
    passed_s, stages = share * sum(took_s.values()), []
    begin_s = 0.0
    for name, (units, num_chunks) in STAGES.items():
        end_s = begin_s + took_s[name]
        done = int(units * min(1.0, max(0.0, (passed_s - begin_s) / took_s[name])))
        begun, ended = passed_s > begin_s, passed_s >= end_s
        state = ChunkState.DONE if ended else ChunkState.RUNNING if begun else ChunkState.WAITING
        started_at = START + timedelta(seconds=begin_s) if begun else None
        finished_at = START + timedelta(seconds=end_s) if ended else None
        taking_part = min(num_workers, num_chunks) if begun else 1
        stages.append(StageProgress(name, state, done, units, started_at, finished_at, False, num_chunks, taking_part))
        begin_s = end_s
    return stages, START + timedelta(seconds=passed_s), sum(took_s.values()) - passed_s


@given(pace=floats(0.1, 20.0), num_workers=integers(1, 8), share=floats(0.1, 0.95))
def test_time_left_is_right_at_any_pace(pace: float, num_workers: int, share: float) -> None:
    stages, now, left_s = simulated(pace, num_workers, share)
    assert time_left_s(stages, CONFIG, now) == pytest.approx(left_s, rel=0.1)


def test_slower_machine_is_noticed_within_stage() -> None:
    """Detection that takes three times as long as it did before takes so for the rest."""
    stages, now, _ = simulated(1.0, 2, 0.1)
    detect = next(stage for stage in stages if stage.name == DETECT)
    assert detect.started_at is not None
    later = now + 2.0 * (now - detect.started_at)
    quick, slow = (time_left_s(stages, CONFIG, moment) for moment in (now, later))
    assert quick is not None
    assert slow is not None
    assert 2.8 < slow / quick < 3.1


def test_nothing_is_foreseen_before_work_is_done() -> None:
    stages = [StageProgress(DETECT, ChunkState.RUNNING, 0, 400, START, None, False, 4, 1)]
    assert time_left_s(stages, CONFIG, START) is None
