"""Times of first pictures that containers state early, from the durations of the first packets."""

from collections.abc import Sequence

import pytest

from pipeline.video.stamps import early_start


@pytest.mark.parametrize(
    ("durations", "early"),
    [
        ([810, 512, 512, 512, 512], 298),  # AAC of 44.1 kHz: 1024 samples
        ([785, 512, 512, 512, 512], 273),  # AAC of 48 kHz
        ([1152, 512, 512, 512, 512], 640),  # sound that begins 50 ms before the pictures
        ([55, 34, 33, 33, 34], 21),  # ticks of a millisecond
        ([512, 512, 512, 512, 512], 0),
        ([513, 512, 512, 512, 512], 0),  # rounding
        ([1024, 512, 512, 512, 512], 0),  # a dropped frame
        ([2048, 512, 512, 512, 512], 0),
        ([400, 512, 512, 512, 512], 0),
        ([810, 512, 700, 512, 512], 0),  # a rate that varies
        ([810, 512, 512], 0),
        ([810, 512, 512, 512, 0], 0),  # the end of a short stream
        ([], 0),
    ],
)
def test_early_start_lengthens_first_frame(durations: Sequence[int], early: int) -> None:
    assert early_start(list(durations)) == early
