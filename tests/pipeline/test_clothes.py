"""Clothes of simulated people: the colours of each person's detections."""

from dataclasses import replace

import numpy as np

from pipeline.association.identity.clothes import mean_clothes
from pipeline.detection.appearance import NUM_BINS, PARTS
from pipeline.validation.simulation.scenes import SCENES, record
from tests.pipeline.clothes import dress


def test_detections_have_colours_of_their_person() -> None:
    room = record(replace(SCENES["noisy"], duration_s=2.0), 1)
    dressed = dress(room, lambda person, time_s: person if time_s < 1.0 else 0)
    num_false = 0
    for name, of_camera in dressed.detections.items():
        assert of_camera.colour.shape == (len(of_camera.frame), len(PARTS), NUM_BINS)
        np.testing.assert_array_equal(of_camera.keypoints_px, room.detections[name].keypoints_px)
        is_person = room.identities[name] >= 0
        num_false += int((~is_person).sum())
        np.testing.assert_array_equal(of_camera.colour.any((1, 2)), is_person)
        total = of_camera.colour[is_person].sum(-1, dtype=int)
        assert np.abs(total - 255).max() <= NUM_BINS // 2
        early = room.times[name].time_s[of_camera.frame] < 1.0
        shares = {
            (person, is_early): mean_clothes(of_camera.colour[rows], np.zeros(rows.sum(), int), 1).share[0]
            for person in (0, 1)
            for is_early in (True, False)
            if (rows := (room.identities[name] == person) & (early == is_early)).sum() > 5
        }
        for key, share in shares.items():
            other = shares.get((0, True), share)
            alike = float(np.sqrt(share * other).sum(-1).min())
            assert alike > 0.95 if key != (1, True) else alike < 0.8
    assert num_false > 0
