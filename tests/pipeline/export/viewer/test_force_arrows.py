"""Arrows of forces in the files for viewers and in reports: what a plain reader finds in the records."""

import base64
import json
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import SIDES
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import person_views
from pipeline.export.report.contents import embed_motion
from pipeline.export.viewer.description import ViewerMotion
from pipeline.export.viewer.frames import ABSENT, force_arrows_m
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.person_forces import PersonForces
from tests.pipeline.export.viewer.takes import walk_with_forces

LENGTH_M = 1.0  # of a force as large as the body's weight

Walk = tuple[Reconstruction, PersonForces]


@pytest.fixture(scope="module")
def walk() -> Walk:
    return walk_with_forces()


def read_m(description: dict[str, Any], content: bytes, person: int, num_rows: int, row: int) -> np.ndarray:
    """Tail and tip of both feet in ``num_rows`` records of a person; NaN for absent ends."""
    record = description["record"]
    num_bytes, offsets = record["num_bytes"], record["offsets"]
    start = (person * num_rows + row) * num_bytes
    origin_m = np.frombuffer(content, "<f4", 3, start + offsets["origin_m"])
    steps = np.frombuffer(content, "<i2", 12, start + offsets["forces"]).astype(float)
    steps[steps == ABSENT] = np.nan
    return (origin_m + (steps * description["people"][person]["position_step_m"]).reshape(4, 3)).reshape(2, 2, 3)


def test_records_have_arrows_of_standing_feet_alone(walk: Walk) -> None:
    take, forces = walk
    arrows_m = {1: force_arrows_m(forces)}
    motion = ViewerMotion(take, person_views(take), {}, quality_report(take), arrows_m=arrows_m)
    content = b"".join(motion.encode())
    description = json.loads(motion.describe())
    track, num_rows = take.tracks[0], take.tracks[0].num_frames
    toes = take.joints.indices(tuple(f"{side}_big_toe" for side in SIDES))
    stands = np.array(forces.feet.stands)
    assert {tuple(row) for row in stands.tolist()} >= {(True, True), (True, False), (False, True)}
    for row in range(0, num_rows, 7):
        found_m = read_m(description, content, 0, num_rows, row)
        assert np.isfinite(found_m).all((1, 2)).tolist() == stands[row].tolist()
        tail_m, tip_m = found_m[stands[row]].swapaxes(0, 1)
        force = forces.feet.force[row, stands[row]]
        np.testing.assert_allclose(tip_m - tail_m, LENGTH_M / GRAVITY_M_S2 * force, atol=1.1e-4)  # of half a step each
        # Each arrow begins on the floor below its own foot.
        assert (np.linalg.norm((tail_m - track.xyz_m[row, toes][stands[row]])[:, :2], axis=1) < 0.3).all()
        assert np.isnan(read_m(description, content, 1, num_rows, row)).all()
    # A standing person's arrows are together as long as the weight.
    quiet_m = read_m(description, content, 0, num_rows, 5)
    assert (quiet_m[:, 1] - quiet_m[:, 0]).sum(0)[2] == pytest.approx(LENGTH_M, rel=0.1)


def test_takes_without_forces_have_no_bytes_of_arrows(walk: Walk) -> None:
    take, forces = walk
    views, report = person_views(take), quality_report(take)
    plain = embed_motion(take, views, report)
    assert "forces" not in plain["record"]["offsets"]
    arrows_m = {1: force_arrows_m(forces)}
    document = embed_motion(take, views, report, arrows_m=arrows_m)
    # Four ends of three 16-bit numbers.
    assert document["record"]["num_bytes"] - plain["record"]["num_bytes"] in {24, 28}
    content, num_rows = base64.b64decode(document["frames"]), take.tracks[0].num_frames
    assert document["stride"] == 1
    found_m = read_m(document, content, 0, num_rows, 100)
    np.testing.assert_allclose(found_m.reshape(4, 3), arrows_m[1][100], atol=1e-4)
