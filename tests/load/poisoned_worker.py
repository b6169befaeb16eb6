"""Program for tests: the service's worker, whose process is killed by each chunk of a session named ``POISON``.

It dies as by the system's hand when memory is short: at once, with its lease, and without a word.
"""

import os
import signal
from typing import Any

from pipeline.run.engine.stage import Output
from worker import __main__ as worker_main
from worker.run import tasks
from worker.run.chunk import Work
from worker.run.runner import Runner

POISON = "poison"


class PoisonedRunner(Runner):
    """Runner of the pipeline's stages that dies of poison."""

    def __init__(self, **parts: Any) -> None:
        run_chunk = parts.pop("run")

        def run(work: Work) -> Output:
            if work.session.name == POISON:
                os.kill(os.getpid(), signal.SIGKILL)
            output: Output = run_chunk(work)
            return output

        super().__init__(run=run, **parts)


if __name__ == "__main__":
    setattr(tasks, "Runner", PoisonedRunner)  # noqa: B010 - its type is another
    worker_main.main()
