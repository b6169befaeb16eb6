"""Program for tests: a worker whose stages are small, see ``run.light_service``, on the store of its settings.

Every unit of the detection takes ``LIGHT_FRAME_S`` seconds, and none of them the processor.
"""

from tests.worker.run.light_service import run_worker

if __name__ == "__main__":
    run_worker()
