"""Time that is left of a running job: foreseen work, at the pace at which its stages were measured."""

from collections.abc import Iterable
from datetime import datetime

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.costs import unit_s
from worker.store.model.job_records import StageProgress

# Share of a stage after which its own rate tells more than the stages before it.
_TELLING = 0.05


def time_left_s(stages: Iterable[StageProgress], config: ReconstructionConfig, now: datetime) -> float | None:
    """Estimate the time that is left of a job whose attempt began; ``None`` before a unit is done.

    A stage that has begun continues at its own rate. Stages that follow take their foreseen work, times the ratio of
    measured to foreseen time so far: a busy machine has a large one. A stage uses as many of the job's workers as it
    has chunks. Outputs of an earlier job took no time.
    """
    at_work = [stage for stage in stages if not stage.reused]
    worked = [stage for stage in at_work if stage.done and stage.started_at is not None]
    num_workers = max((stage.num_workers for stage in worked), default=1)

    def foreseen_s(stage: StageProgress, num_units: int) -> float:
        return num_units * unit_s(stage.name, config) / min(stage.num_chunks, num_workers)

    def spent_s(stage: StageProgress) -> float:
        return ((stage.finished_at or now) - (stage.started_at or now)).total_seconds()

    done_s = sum(foreseen_s(stage, stage.done) for stage in worked)
    if not done_s:
        return None
    pace = sum(map(spent_s, worked)) / done_s
    return sum(
        spent_s(stage) / stage.done * (stage.total - stage.done)
        if stage.done > _TELLING * stage.total
        else foreseen_s(stage, stage.total - stage.done) * pace
        for stage in at_work
    )
