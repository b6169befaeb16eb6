"""Celery, configured so that nothing depends on it: a message says that there is work, the database says what.

A message is acknowledged after its work, and one whose worker was lost is put back. The limits below only bound what
the reaper would mend anyway.
"""

import os
import threading
import time

from celery import Celery, Task
from celery.signals import (
    celeryd_init,
    setup_logging,
    worker_init,
    worker_process_init,
    worker_process_shutdown,
    worker_ready,
    worker_shutting_down,
)

from pipeline.runtime.memory import limit_memory
from worker import tasks
from worker.jobs.queue import QUEUE_NAME, TASK_NAME
from worker.process.presence import Presence
from worker.process.priorities import stand_back
from worker.process.scratch import remove_abandoned
from worker.settings import WorkerSettings
from worker.telemetry import tracing
from worker.telemetry.logs import configure_logs

# Longer than the longest chunk: a reduce of hours of capture.
_TIME_LIMIT_S = 3600

_LOOK_S = 0.1

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
        worker_pool="worker.process.pool:PromptPool",
        worker_prefetch_multiplier=1,
        # The libraries of science take seconds to load on a busy machine; where compiled kernels can't be kept, every
        # process compiles them first, for minutes.
        worker_proc_alive_timeout=600.0,
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
    worker_init.connect(_tell_loading)
    worker_process_init.connect(_load)
    worker_ready.connect(_consume)
    worker_shutting_down.connect(_give_back)
    return celery


def _work(task: Task) -> None:
    traceparent = task.request.get("traceparent")
    with tracing.message_span({"traceparent": traceparent} if traceparent else {}):
        tasks.work()


def _log(**_: object) -> None:
    configure_logs(WorkerSettings().log_level)


def _one_thread_a_process(**_: object) -> None:
    """Before any child loads NumPy: several processes use a processor better than several threads of each."""
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))


def _stand_back(**_: object) -> None:
    stand_back(WorkerSettings().nice)


def _tell_loading(**_: object) -> None:
    """On a busy machine it has taken seconds to get here."""
    tasks.tell_loading()


def _load(**_: object) -> None:
    limit_memory(WorkerSettings().memory_bytes)
    presence = tasks.start_presence()
    worker_process_shutdown.connect(lambda exitcode, **_: _unload(presence, exitcode), weak=False)
    threading.Thread(target=_end_while_loading, args=[presence], daemon=True).start()
    tracing.start("multicap-worker")
    remove_abandoned()
    tasks.load()


def _end_while_loading(presence: Presence) -> None:
    """Loading takes seconds, in which a process hears nothing: a shutdown need not wait for it."""
    while not tasks.is_loaded():
        if tasks.shutting_down.is_set():
            presence.stop()
            os._exit(0)
        time.sleep(_LOOK_S)


def _unload(presence: Presence, exitcode: int) -> None:
    presence.stop()
    tracing.stop()
    if tasks.shutting_down.is_set():
        # The pool would have the process sleep for a second, lest its last message be lost: now nobody reads it.
        os._exit(exitcode)


def _consume(**_: object) -> None:
    """The main process takes messages now; children that are loaded can start."""
    tasks.consuming.set()


def _give_back(**_: object) -> None:
    """A shutdown waits for the tasks at hand, and these may run for long: have them give back their chunks."""
    tasks.shutting_down.set()
