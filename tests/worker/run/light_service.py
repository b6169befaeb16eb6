"""Program for tests: broker, worker and reaper under the supervisor, with small stages in place of the pipeline's.

``python tests/worker/run/light_service.py DATA`` runs all; with ``--worker`` it is the worker. Frames take
``LIGHT_FRAME_S`` seconds.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from pipeline.run.engine.stage import DETECT, Output
from tests.worker.conftest import LIGHT_STAGES, detect
from worker import __main__ as worker_main
from worker.run import embedded
from worker.run.chunk import Work
from worker.run.settings import WorkerSettings
from worker.run.supervisor import Supervisor
from worker.store.store import JobStore


def slow_detect(work: Work) -> Output:
    def on_unit() -> None:
        time.sleep(float(os.environ["LIGHT_FRAME_S"]))
        work.on_unit()

    return detect(replace(work, on_unit=on_unit))


def run_worker() -> None:
    stages = LIGHT_STAGES | {DETECT: slow_detect}
    execution = ModuleType("worker.run.execution")
    execution.run_chunk = lambda work: stages[work.claim.stage](work)  # type: ignore[attr-defined]
    execution.warm_up = lambda: None  # type: ignore[attr-defined]
    sys.modules["worker.run.execution"] = execution
    worker_main.main()


def run_all(data_dir: Path) -> None:
    with embedded.lock(data_dir) as directory:
        JobStore(WorkerSettings(data_dir=directory.path).resolved_database_url).migrate()
        worker = embedded.worker(directory, workers=2)
        here = [sys.executable, __file__, "--worker", "--workers", "2"]
        Supervisor(
            [embedded.broker(directory), replace(worker, command=here), embedded.reaper(directory)],
            directory.logs_dir,
            say,
        ).run()


def say(sentence: str) -> None:
    sys.stderr.write(f"{sentence}\n")


if __name__ == "__main__":
    if sys.argv[1] == "--worker":
        del sys.argv[1]
        run_worker()
    else:
        run_all(Path(sys.argv[1]))
