"""Compile the numeric kernels before workers are forked, and say how far that is.

A first start takes about a minute for it. Celery would take forked children that compile for dead ones, and each of
them would compile all; so a program of its own compiles before there are any. Where all is compiled this takes
milliseconds, and loads nothing.
"""

import json
import subprocess
import sys
from dataclasses import replace

import structlog

from pipeline.runtime.child_processes import module_command
from pipeline.runtime.kernel_cache import cache_folder, is_complete
from worker.jobs.store import JobStore
from worker.jobs.worker_status import WorkerState, WorkerStatus
from worker.process.lifeline import tied
from worker.process.presence import Presence, process_name

log = structlog.get_logger()

COMPILING = "A worker compiles the numeric kernels"

_LOG_EVERY = 10


def compile_kernels(store: JobStore) -> None:
    """Compile what is not compiled yet, and list this process as a worker that does it.

    The program ends with a sentence if that fails.
    """
    if is_complete():
        return
    if cache_folder() is None:
        log.warning("kernel_cache_unavailable", hint="Every worker process compiles for itself. Set MULTICAP_HOME.")
        return
    status = WorkerStatus(process_name(), WorkerState.STARTING, COMPILING)
    presence = Presence(store.workers, lambda: status)
    presence.start()
    log.info("kernels_compiling", hint="A first start takes about a minute.")
    done = total = 0
    try:
        command = tied(module_command("pipeline.runtime.warm_up", "--progress"))
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:  # noqa: S603 - it is ours
            try:
                for line in program.stdout or ():
                    said = json.loads(line)
                    done, total = said["done"], said["total"]
                    status = replace(status, done=min(done, total), total=total)
                    if done % _LOG_EVERY == 0:
                        log.info("kernels_compiling", done=done, total=total)
            except BaseException:  # SIGTERM above all: it must not be waited for
                program.kill()
                raise
        if program.returncode != 0:
            log.error("kernels_not_compiled", exit_code=program.returncode)
            sys.exit("error: The numeric kernels could not be compiled, so nothing can be reconstructed. See above.")
        log.info("kernels_compiled", done=done, total=total)
    finally:
        presence.stop()
