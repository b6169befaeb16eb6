"""Damaged files: each is read, or refused with sentences."""

import random
from pathlib import Path

import pytest

from pipeline.calibration.registry import read_contents
from pipeline.core.errors import InputError
from tests.hostile.calibrations import in_every_format
from tests.hostile.mutations import OF_TEXT, spoil
from tests.pipeline.calibration.readers.rigs import RIG


@pytest.mark.parametrize("name", ["mamma.yaml", "camchain.yaml", "human36m.json"])
def test_damaged_file_is_read_or_refused(tmp_path: Path, name: str) -> None:
    rng, good, path = random.Random(36), in_every_format(RIG)[name], tmp_path / name  # noqa: S311 - the same each time
    num_refused = 0
    for _ in range(100):
        path.write_bytes(spoil(good, rng, OF_TEXT))
        try:
            contents = read_contents(path)
        except InputError as error:
            num_refused += 1
            messages = [problem.message for problem in error.problems]
        else:
            messages = [] if contents.cameras else ["no camera"]
        assert all(message.endswith(".") for message in messages)
    assert num_refused > 20
