"""Detect leaning bodies that are elsewhere than they were looked for, in a range of a camera's frames.

The output is a ``Detections``.
"""

from pipeline.run.engine.stage import EXPECT_AGAIN, LOOK, REDETECT_AGAIN, SYNCHRONIZE, Context, Output, Stage, Task
from pipeline.run.steps.redetect import is_redetecting, read_expected


def redetect_again(task: Task, context: Context) -> Output:
    """Read the joints of the bodies of ``expect_again`` in crops."""
    return read_expected(task, context, EXPECT_AGAIN)


STAGE = Stage(
    REDETECT_AGAIN,
    "Detect them there",
    redetect_again,
    cut="camera ranges",
    follows=(LOOK, SYNCHRONIZE, EXPECT_AGAIN),
    choices=("profile", "joints", "detector", "output"),
    is_planned=is_redetecting,
    frames_a_unit=50,
    reads_videos=True,
    runs_networks=True,
)
