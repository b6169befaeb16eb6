"""Plots of forces in a report: over time with bands, and over strides."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from pipeline.export.report.biomechanics import PersonAngles
from pipeline.export.report.force_plots import force_parts
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.forces.person_forces import PersonForces
from tests.pipeline.motion.forces.physical_people import estimated, solved
from tests.pipeline.motion.gait.walks import gait_of, walk

ACT = walk(1.2)


def page_of(forces: PersonForces | None) -> ElementTree.Element:
    animation = solved(ACT)
    angles = joint_angles(animation.motions[0], animation.tracks[0], ACT.joints)
    person = PersonAngles("Ada", angles, {}, gait_of(ACT).strides, forces)
    parts = "".join(force_parts([person], ACT.rate_hz)).replace("<details open>", '<details open="">')
    return ElementTree.fromstring(f"<main>{parts}</main>")  # noqa: S314 - our own page


@pytest.fixture(scope="module")
def page() -> ElementTree.Element:
    return page_of(estimated(ACT))


def test_person_without_forces_has_no_plot() -> None:
    assert len(page_of(None)) == 0


def test_vertical_force_has_a_line_and_a_band_of_each_foot(page: ElementTree.Element) -> None:
    svg = next(page.iter("svg"))
    assert [path.attrib["class"] for path in svg.iter("path")] == ["left", "right"]
    assert {band.attrib["class"] for band in svg.iter("polygon")} == {"left", "right"}
    # A foot carries at least all of the weight, and 100 % is a line of the scale.
    assert "100%" in {text.text for text in svg.iter("text")}
    largest = re.search(r"to (\d+) %", svg.attrib["aria-label"])
    assert largest
    assert 100 < int(largest[1]) < 180


def test_band_is_two_deviations_wide(page: ElementTree.Element) -> None:
    forces = estimated(ACT)
    svg = next(page.iter("svg"))
    low, high = (float(text.attrib["y"]) for text in svg.iter("text") if text.text in {"0%", "100%"})
    pixels = abs(high - low) / 100.0
    band = next(svg.iter("polygon")).attrib["points"].split()
    places = np.array([[float(value) for value in point.split(",")] for point in band])
    half = len(places) // 2
    heights = places[:half, 1] - places[half:, 1][::-1]
    rows = np.unique(np.linspace(0, len(forces.total) - 1, min(len(forces.total), 326)).round().astype(int))
    expected = 4.0 * 100.0 / forces.weight * forces.feet.sigma[rows, 0, 2] * pixels
    np.testing.assert_allclose(heights, expected[: len(heights)], atol=0.3)


def test_strides_have_forces_and_moments(page: ElementTree.Element) -> None:
    titles = [caption.text or "" for caption in page.iter("figcaption")]
    assert [title.split(",")[0].strip() for title in titles[1:]] == [
        "Vertical force",
        "Moment of hip flexion",
        "Moment of knee flexion",
        "Moment of ankle dorsiflexion",
    ]
    ticks = [float(text.text or "") for text in list(page.iter("svg"))[2].iter("text") if "%" not in (text.text or "")]
    assert 2 <= len(ticks) <= 5
    assert max(map(abs, ticks)) < 3.0  # N m/kg
    assert "estimated from the stature" in (next(page.iter("summary")).text or "")


def test_mean_in_flights_is_shown_as_a_check(page: ElementTree.Element) -> None:
    assert "in flights" not in "".join(page.itertext())
    shown = "".join(page_of(replace(estimated(ACT), flight_residual=-0.031)).itertext())
    assert "the mean in flights was -3.1 % of body weight" in shown
