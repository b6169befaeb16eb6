"""Progress of a stage by the units of its tasks, of which several may be at hand at once."""

from pipeline.core.progress import OnProgress, Progress
from pipeline.run.engine.plan import PlannedStage
from pipeline.run.engine.stage import Task


class UnitCounter:
    """Counter of the units of a stage that are done; it reports each of them."""

    def __init__(self, stage: PlannedStage, on_progress: OnProgress) -> None:
        self._stage, self._on_progress = stage.name, on_progress
        self._total = stage.num_units
        self._reused = self._whole = 0
        self._units = dict[int, int]()  # Units of each task at hand
        self._report()

    def on_unit(self, task: Task) -> None:
        """Count a unit of a task at hand. The number of units of a task is a good guess before it has run."""
        self._units[task.index] = min(self._units.get(task.index, 0) + 1, task.num_units)
        self._report()

    def finish(self, task: Task, is_reused: bool) -> None:
        """Count a whole task."""
        self._units.pop(task.index, None)
        self._whole += task.num_units
        self._reused += task.num_units if is_reused else 0
        self._report()

    def _report(self) -> None:
        done = self._whole + sum(self._units.values())
        self._on_progress(Progress(self._stage, done, self._total, self._reused))
