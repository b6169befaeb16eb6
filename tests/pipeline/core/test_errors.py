import pickle

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.session_codes import VIDEO_DAMAGED


def test_problems_survive_way_out_of_detection_process() -> None:
    error = InputError([Problem(VIDEO_DAMAGED, "Frame 3 can't be decoded.", file="a.mp4", camera="a")])
    back = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own bytes
    assert (back.problems, str(back)) == (error.problems, str(error))
