"""Celery application of the workers: one task, its pool of processes, and handlers that prepare each process.

A message only tells workers that there is work; they claim it in the database. A message is acknowledged after its
work, and returns to the queue if its worker is lost.
"""

import os
import stat
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from billiard.pool import CLOSE, RUN
from celery import Celery, Task
from celery.concurrency.prefork import TaskPool
from celery.signals import (
    celeryd_init,
    setup_logging,
    worker_init,
    worker_process_init,
    worker_process_shutdown,
    worker_ready,
    worker_shutting_down,
)
from celery.worker.request import Request
from kombu.transport.virtual import QoS

from pipeline.core.runtime.resources import limit_memory, lower_priority
from worker.run import tasks, tracing
from worker.run.logs import configure_logs
from worker.run.presence import Presence, remove_abandoned
from worker.run.settings import WorkerSettings
from worker.store.queue import TASK_NAME, Queue, transport_options

# Time after which the broker sends a message again that no worker has acknowledged: it only wakes a worker once more.
_REDELIVERY_S = 3600

# Longer than the broker keeps a worker waiting for a message, a second.
_BROKER_TIMEOUT_S = 15.0

_LOOK_S = 0.1

_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


_LAST_STREAM = 2


def create_celery(settings: WorkerSettings) -> Celery:
    """Create the Celery application with its only task."""
    celery = Celery("multicap", broker=settings.broker_url)
    celery.conf.update(
        task_default_queue=Queue.ALL,
        task_ignore_result=True,
        task_acks_late=True,
        task_reject_on_worker_lost=True,
        worker_pool="worker.run.app:PromptPool",
        worker_prefetch_multiplier=1,
        # Numeric libraries take seconds to load on a busy machine. Without a cache for compiled kernels every process
        # compiles them first, which takes minutes.
        worker_proc_alive_timeout=600.0,
        worker_enable_remote_control=False,
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        broker_transport_options={
            "visibility_timeout": _REDELIVERY_S,
            "unacked_restore_interval": 10,
            "unacked_restore_throttle": 1,
            **transport_options(_BROKER_TIMEOUT_S),
        },
    )
    celery.task(name=TASK_NAME, bind=True, Request="worker.run.app:WakingRequest")(_work)
    setup_logging.connect(_log)
    celeryd_init.connect(_one_thread_a_process)
    celeryd_init.connect(_lower_priority)
    worker_init.connect(_report_loading)
    worker_process_init.connect(_load)
    worker_ready.connect(_consume)
    worker_shutting_down.connect(_return_chunks)
    return celery


def _work(task: Task) -> None:
    traceparent = task.request.get("traceparent")
    with tracing.message_span({"traceparent": traceparent} if traceparent else {}):
        tasks.work(is_for_all=(task.request.delivery_info or {}).get("routing_key") == Queue.ALL)


def _log(**_: object) -> None:
    configure_logs(WorkerSettings().log_level)


def _one_thread_a_process(**_: object) -> None:
    """Use one thread for each process: several processes use the processors better than several threads of each.

    The environment must be set before a child imports NumPy.
    """
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))


def _lower_priority(**_: object) -> None:
    lower_priority(WorkerSettings().nice)


def _report_loading(**_: object) -> None:
    """Report again that workers load: on a busy machine Celery took seconds to start."""
    tasks.report_loading()


def _load(**_: object) -> None:
    release_inherited_sockets()
    limit_memory(WorkerSettings().memory_bytes)
    presence = tasks.start_presence()
    worker_process_shutdown.connect(lambda exitcode, **_: _unload(presence, exitcode), weak=False)
    threading.Thread(target=_end_while_loading, args=[presence], daemon=True).start()
    tracing.start("multicap-worker")
    remove_abandoned()
    tasks.load()


def _end_while_loading(presence: Presence) -> None:
    """End the process if a shutdown begins while it loads: it could not react for seconds."""
    while not tasks.is_loaded():
        if tasks.shutting_down.is_set():
            presence.stop()
            os._exit(0)
        time.sleep(_LOOK_S)


def _unload(presence: Presence, exitcode: int) -> None:
    presence.stop()
    tracing.stop()
    if tasks.shutting_down.is_set():
        # The pool would let the process sleep for a second to deliver its last message, which is not read any more.
        os._exit(exitcode)


def _consume(**_: object) -> None:
    """Record that the main process receives messages: loaded children can get work now."""
    tasks.consuming.set()


def _return_chunks(**_: object) -> None:
    """Tell running tasks to return their chunks: a shutdown waits for them, and a chunk may take long."""
    tasks.shutting_down.set()


class WakingRequest(Request):  # type: ignore[misc]  # Celery has no types
    """Message in work, which never keeps a worker from receiving others.

    kombu 5.7.0 counts a message as held for good if its acknowledgement fails, as while the broker restarts. A worker
    whose processes all hold such a message would receive no more, and not notice that its connection is lost.
    """

    message: Any

    def acknowledge(self) -> None:
        """Acknowledge the message; count it as acknowledged also if the broker does not answer."""
        super().acknowledge()
        if not self.message.acknowledged:
            QoS.ack(self.message.channel.qos, self.message.delivery_tag)  # type: ignore[no-untyped-call]


class PromptPool(TaskPool):  # type: ignore[misc]  # Celery has no types
    """Pool that ends as soon as its last process has ended.

    Celery's own pool acknowledges messages from a thread while it ends, and checks twice a second whether it has ended.
    A message without an acknowledgement is delivered again and announces work once more, which does no harm here.
    """

    _pool: Any

    def on_stop(self) -> None:
        """Wait until the processes have returned their chunks and ended."""
        if self._pool is not None and self._pool._state in {RUN, CLOSE}:
            self._pool.close()
            self._pool.join()
            self._pool = None


def release_inherited_sockets() -> None:
    """Put ``/dev/null`` in place of the sockets that this process, which was just forked, has of its parent.

    A child that replaces a lost one inherits the connections to the broker. As long as it holds one that both ends have
    closed since, as when the broker restarts, Linux reports it to the parent again and again, which then does nothing
    but ask. The numbers stay taken: objects of the parent that close them later close no file of this process.
    Standard streams stay, which may be sockets of a journal.
    """
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in [int(entry.name) for entry in Path("/dev/fd").iterdir()]:
        with suppress(OSError):  # the folder itself was open
            if number > _LAST_STREAM and stat.S_ISSOCK(os.fstat(number).st_mode):
                os.dup2(nothing, number, inheritable=False)
    os.close(nothing)
