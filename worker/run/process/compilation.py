"""Compilation of the numeric kernels before workers are forked, with its progress in the list of workers.

The first start takes some minutes. Celery would consider forked children dead while they compile, and each child
would compile all kernels. So a program of its own compiles them before the fork. If all kernels are compiled, this
takes milliseconds and imports no numeric library.
"""

import json
import subprocess
import sys
from dataclasses import replace

import structlog

from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.kernel_cache import cache_folder, is_complete
from pipeline.core.runtime.parent_watch import tied_to_parent
from worker.run.process.presence import Presence, process_name
from worker.store.store import JobStore
from worker.store.worker_status import WorkerState, WorkerStatus

log = structlog.get_logger()

COMPILING = "A worker compiles the numeric kernels"

_LOG_EVERY = 10


def compile_kernels(store: JobStore) -> None:
    """Compile missing kernels, and list this process among the workers meanwhile; exit with a message on failure."""
    if is_complete():
        return
    if cache_folder() is None:
        log.warning("kernel_cache_unavailable", hint="Every worker process compiles all kernels. Set MULTICAP_HOME.")
        return
    status = WorkerStatus(process_name(), WorkerState.STARTING, COMPILING)
    presence = Presence(store.workers, lambda: status)
    presence.start()
    log.info("kernels_compiling", hint="A first start takes some minutes.")
    done = total = 0
    try:
        command = tied_to_parent(module_command("pipeline.run.warm_up", "--progress"))
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:  # noqa: S603 - our own command
            try:
                for line in program.stdout or ():
                    progress = json.loads(line)
                    done, total = progress["done"], progress["total"]
                    status = replace(status, done=min(done, total), total=total)
                    if done % _LOG_EVERY == 0:
                        log.info("kernels_compiling", done=done, total=total)
            except BaseException:  # such as SIGTERM: leaving the block would wait for the program
                program.kill()
                raise
        if program.returncode != 0:
            log.error("kernels_not_compiled", exit_code=program.returncode)
            sys.exit("error: The numeric kernels could not be compiled; without them nothing can be reconstructed.")
        log.info("kernels_compiled", done=done, total=total)
    finally:
        presence.stop()
