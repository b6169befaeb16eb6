"""Joint angles in a report: plots of flexion over time, left beside right, and a table of ranges of motion."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.angles.compute import JointAngles
from pipeline.angles.definitions import ANGLE_NAMES, JOINTS
from pipeline.report.markup import Markup, element, joined

MAX_PEOPLE = 10
"""Largest number of people whose angles are in a report; ``metrics.json`` has those of all."""

_Place = Callable[[Float[np.ndarray, " points"]], Float[np.ndarray, " points"]]

# Angles of limbs that have a plot, and its title.
_PLOTS = {
    "hip_flexion": "Hip flexion",
    "knee_flexion": "Knee flexion",
    "ankle_dorsiflexion": "Ankle dorsiflexion",
    "shoulder_elevation": "Shoulder elevation",
    "elbow_flexion": "Elbow flexion",
}
_SIDES = ("left", "right")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 360, 130, 34, 16, 6
# Largest number of points of a line: a pixel of the plot has one.
_MAX_POINTS = _WIDTH - _LEFT
_LEAST_SPAN_DEG = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class PersonAngles:
    """Joint angles of a person under the person's name."""

    name: str
    angles: JointAngles
    ranges: Mapping[str, Mapping[str, Any]]  # ``angles`` of the person in ``metrics.json``


def angle_parts(people: Sequence[PersonAngles], frame_rate_hz: float) -> Iterable[Markup]:
    """Parts of the section on joint angles: for each person plots and a table, folded up if there are several."""
    for person in people:
        column = {name: person.angles.angle_deg[:, number] for number, name in enumerate(ANGLE_NAMES)}
        plots = [
            _plot(title, {side: column[f"{side}_{name}"] for side in _SIDES}, person.angles.start_frame, frame_rate_hz)
            for name, title in _PLOTS.items()
            if any(f"{side}_{name}" in person.ranges for side in _SIDES)
        ]
        yield element(
            "details",
            element("summary", person.name),
            element("div", plots, class_="plots"),
            _table(person),
            open=len(people) == 1,
        )


def _table(person: PersonAngles) -> Markup:
    """Ranges of motion: a row an angle, with both sides beside each other."""
    rows = []
    for joint in JOINTS:
        for angle in joint.angles:
            names = [f"{side}_{angle.name}" for side in _SIDES] if joint.is_sided else [angle.name]
            if any(name in person.ranges for name in names):
                cells = [_range(person.ranges.get(name)) for name in names]
                title = angle.name.replace("_", " ").capitalize()
                span = 1 if joint.is_sided else 2
                rows.append(
                    element(
                        "tr",
                        element("th", title, scope="row"),
                        (element("td", cell, colspan=span) for cell in cells),
                        element("td", angle.meaning),
                    )
                )
    columns = ("Angle", "Left", "Right", "Positive")
    head = element("thead", element("tr", (element("th", column, scope="col") for column in columns)))
    caption = f"Ranges of motion of {person.name}: smallest to largest angle, with the median standard deviation"
    table = element("table", element("caption", caption), head, element("tbody", rows))
    return element("div", table, class_="scroll", tabindex=0, role="group", aria_label=caption)


def _range(found: Mapping[str, Any] | None) -> str:
    if found is None:
        return "-"
    sigma = "" if found["sigma_deg"] is None else f" ± {found['sigma_deg']:.1f}"
    return f"{round(found['min_deg'])} to {round(found['max_deg'])}°{sigma}"


def _plot(
    title: str, lines_deg: Mapping[str, Float[np.ndarray, " frames"]], start_frame: int, frame_rate_hz: float
) -> Markup:
    """Plot of an angle of both sides over the frames of a person, with a gap where it is unknown."""
    known_deg = np.concatenate([line[np.isfinite(line)] for line in lines_deg.values()])
    middle_deg, span_deg = (known_deg.max() + known_deg.min()) / 2, max(float(np.ptp(known_deg)), _LEAST_SPAN_DEG)
    low_deg, high_deg = middle_deg - 0.55 * span_deg, middle_deg + 0.55 * span_deg
    num_frames = len(next(iter(lines_deg.values())))

    def y(angle_deg: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
        return _TOP + (high_deg - angle_deg) / (high_deg - low_deg) * (_HEIGHT - _BOTTOM - _TOP)

    step_deg = _step_deg(span_deg)
    ticks_deg = np.arange(np.ceil(low_deg / step_deg), np.floor(high_deg / step_deg) + 1) * step_deg
    marks = [
        joined(
            element("line", x1=_LEFT, x2=_WIDTH, y1=f"{place:.1f}", y2=f"{place:.1f}", class_="grid"),
            element("text", f"{round(tick_deg)}°", x=_LEFT - 4, y=f"{place + 4:.1f}", text_anchor="end"),
        )
        for tick_deg, place in zip(ticks_deg, y(ticks_deg), strict=True)
    ]
    end_s = max(num_frames - 1, 1) / frame_rate_hz
    start_s = start_frame / frame_rate_hz
    times = [
        element("text", f"{start_s:.1f} s", x=_LEFT, y=_HEIGHT - 3),
        element("text", f"{start_s + end_s:.1f} s", x=_WIDTH, y=_HEIGHT - 3, text_anchor="end"),
    ]
    curves = [element("path", d=_path(line, y), class_=side) for side, line in lines_deg.items()]
    label = f"{title} from {known_deg.min():.0f} to {known_deg.max():.0f} degrees, left and right"
    box = f"0 0 {_WIDTH} {_HEIGHT}"
    svg = element("svg", marks, times, curves, viewBox=box, width=_WIDTH, height=_HEIGHT, role="img", aria_label=label)
    caption = element("figcaption", title, " ", (element("span", side, class_=f"key {side}") for side in lines_deg))
    return element("figure", svg, caption)


def _step_deg(span_deg: float) -> int:
    """Distance of the lines of a plot: about four of them."""
    return next(step for step in (10, 20, 30, 45, 90, 180, 360) if span_deg / step <= 4 or step == 360)


def _path(line_deg: Float[np.ndarray, " frames"], y: _Place) -> str:
    """Path of a line, thinned out to the pixels of the plot; it is broken where the angle is unknown."""
    rows = np.unique(np.linspace(0, len(line_deg) - 1, min(len(line_deg), _MAX_POINTS)).round().astype(int))
    places = y(line_deg[rows])
    across = _LEFT + rows / max(len(line_deg) - 1, 1) * (_WIDTH - _LEFT)
    words, is_drawing = [], False
    for x, place in zip(across.tolist(), places.tolist(), strict=True):
        if np.isfinite(place):
            words.append(f"{'L' if is_drawing else 'M'}{x:.1f} {place:.1f}")
            is_drawing = True
        else:
            is_drawing = False
    return "".join(words)
