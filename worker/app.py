"""Celery, configured so that nothing depends on it: a message says that there is work, the database says what.

A message is acknowledged after its work, and one whose worker was lost is put back. The limits below only bound what
the reaper would mend anyway.
"""

import os

from celery import Celery, Task
from celery.signals import (
    celeryd_init,
    setup_logging,
    worker_process_init,
    worker_process_shutdown,
    worker_shutting_down,
)

from worker import tasks, tracing
from worker.jobs.queue import QUEUE_NAME, TASK_NAME
from worker.logs import configure_logs
from worker.niceness import stand_back
from worker.scratch import remove_abandoned
from worker.settings import WorkerSettings

# Longer than the longest chunk: a reduce of hours of capture.
_TIME_LIMIT_S = 3600

_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def create_celery(settings: WorkerSettings) -> Celery:
    """Celery with the one task there is."""
    celery = Celery("multicap", broker=settings.broker_url)
    celery.conf.update(
        task_default_queue=QUEUE_NAME,
        task_ignore_result=True,
        task_acks_late=True,
        task_reject_on_worker_lost=True,
        task_time_limit=_TIME_LIMIT_S,
        worker_pool="prefork",
        worker_prefetch_multiplier=1,
        worker_proc_alive_timeout=60.0,  # the libraries of science take seconds to load on a busy machine
        worker_enable_remote_control=False,
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        broker_transport_options={
            "visibility_timeout": _TIME_LIMIT_S + 600,
            "unacked_restore_interval": 10,
            "unacked_restore_throttle": 1,
            "socket_keepalive": True,
        },
    )
    celery.task(name=TASK_NAME, bind=True)(_work)
    setup_logging.connect(_log)
    celeryd_init.connect(_one_thread_a_process)
    celeryd_init.connect(_stand_back)
    worker_process_init.connect(_load)
    worker_process_shutdown.connect(_unload)
    worker_shutting_down.connect(_give_back)
    return celery


def _work(task: Task) -> None:
    traceparent = task.request.get("traceparent")
    with tracing.message_span({"traceparent": traceparent} if traceparent else {}):
        tasks.work()


def _log(**_: object) -> None:
    configure_logs()


def _one_thread_a_process(**_: object) -> None:
    """Before any child loads NumPy: several processes use a processor better than several threads of each."""
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))


def _stand_back(**_: object) -> None:
    stand_back(WorkerSettings().nice)


def _load(**_: object) -> None:
    tracing.start("multicap-worker")
    remove_abandoned()
    tasks.process_runner()


def _unload(**_: object) -> None:
    tracing.stop()


def _give_back(**_: object) -> None:
    """A shutdown waits for the tasks at hand, and these may run for long: have them give back their chunks."""
    tasks.shutting_down.set()
