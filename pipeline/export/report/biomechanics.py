"""Biomechanics in a report: plots of joint angles by side, ranges of motion, tables of gait and movements."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import SIDES
from pipeline.export.report.markup import Markup, element, join
from pipeline.motion.angles.compute import NUM_POINTS, JointAngles, normalised_cycles
from pipeline.motion.body_segments import ANGLE_NAMES, JOINTS
from pipeline.motion.forces.person_forces import PersonForces
from pipeline.motion.gait.movements import MovementKind
from pipeline.motion.gait.strides import Stride
from pipeline.motion.skeleton.feet.floor import find_runs

MAX_PEOPLE = 10
"""Largest number of people whose angles are in a report; ``metrics.json`` has everybody's."""

# Angles of limbs that have a plot, and its title.
_PLOTS = {
    "hip_flexion": "Hip flexion",
    "knee_flexion": "Knee flexion",
    "ankle_dorsiflexion": "Ankle dorsiflexion",
    "shoulder_elevation": "Shoulder elevation",
    "elbow_flexion": "Elbow flexion",
}
_OVER_STRIDES = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 360, 130, 34, 16, 6
# Largest number of points of a line: a pixel of the plot has one.
_MAX_POINTS = _WIDTH - _LEFT
# Least span of a scale and distances of its ticks, by unit.
_TICKS: Mapping[str, tuple[float, tuple[float, ...]]] = {
    "°": (20.0, (10, 20, 30, 45, 90, 180, 360)),
    "%": (20.0, (10, 20, 50, 100, 200, 500, 1000)),
    "N m/kg": (0.5, (0.2, 0.5, 1, 2, 5, 10, 20)),
}


@dataclass(frozen=True, slots=True, eq=False)
class PersonAngles:
    """Joint angles of a person under the person's name."""

    name: str
    angles: JointAngles
    ranges: Mapping[str, Mapping[str, Any]]  # ``angles`` of the person in ``metrics.json``
    strides: Sequence[Stride] = ()  # Strides of the person's gait; rows are the angles'
    forces: PersonForces | None = None  # Forces in the same rows; ``None``: unknown, or not among the exports


def angle_parts(people: Sequence[PersonAngles], frame_rate_hz: float) -> Iterable[Markup]:
    """Parts of the section on joint angles: for each person plots and a table, folded up if there are several."""
    for person in people:
        column = {name: person.angles.angle_deg[:, number] for number, name in enumerate(ANGLE_NAMES)}
        plots = [
            plot(title, {side: column[f"{side}_{name}"] for side in SIDES}, person.angles.start_frame, frame_rate_hz)
            for name, title in _PLOTS.items()
            if any(f"{side}_{name}" in person.ranges for side in SIDES)
        ]
        yield element(
            "details",
            element("summary", person.name),
            element("div", plots, class_="plots"),
            *_gait(person, column),
            _table(person),
            open=len(people) == 1,
        )


def _gait(person: PersonAngles, column: Mapping[str, Float[np.ndarray, " frames"]]) -> Iterable[Markup]:
    """Plots over the steady strides from a foot strike to the next one of the same foot; nothing without gait."""
    plots = []
    for name in _OVER_STRIDES:
        cycles = {
            side: normalised_cycles(
                column[f"{side}_{name}"],
                (
                    (stride.strike_row, stride.next_row)
                    for stride in person.strides
                    if stride.side == side and stride.is_steady
                ),
            )
            for side in SIDES
        }
        if any(map(len, cycles.values())):
            plots.append(cycle_plot(_PLOTS[name], cycles))
    if plots:
        yield element("p", "Steady strides, from foot strike to foot strike: mean and one standard deviation.")
        yield element("div", plots, class_="plots")


def cycle_plot(title: str, cycles: Mapping[str, Float[np.ndarray, "cycles points"]], unit: str = "°") -> Markup:
    """Plot of the mean over cycles of each side, with a band of one standard deviation."""
    known = {side: values for side, values in cycles.items() if len(values)}
    mean = {side: values.mean(0) for side, values in known.items()}
    std = {side: values.std(0, ddof=1) if len(values) > 1 else np.zeros(NUM_POINTS) for side, values in known.items()}
    edges = {side: (mean[side] - std[side], mean[side] + std[side]) for side in known}
    scale = _Scale.fit(np.concatenate([edge for both in edges.values() for edge in both]), unit)
    across = _LEFT + np.linspace(0.0, 1.0, NUM_POINTS) * (_WIDTH - _LEFT)
    drawn = []
    for side, (low, high) in edges.items():
        band = _band(across, scale.y(low), scale.y(high), side)
        drawn += [band, element("path", d=_line(across, scale.y(mean[side])), class_=side)]
    words = {
        side: f"{side}, {len(values)} {'stride' if len(values) == 1 else 'strides'}" for side, values in known.items()
    }
    label = f"{title} over a stride: {'; '.join(words.values())}"
    return _figure(title, label, scale, ("0 %", "100 %"), drawn, words)


def _table(person: PersonAngles) -> Markup:
    """Ranges of motion: a row an angle, with both sides beside each other."""
    rows = []
    for joint in JOINTS:
        for angle in joint.angles:
            names = [f"{side}_{angle.name}" for side in SIDES] if joint.is_sided else [angle.name]
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


def plot(
    title: str,
    lines: Mapping[str, Float[np.ndarray, " frames"]],
    start_frame: int,
    frame_rate_hz: float,
    unit: str = "°",
    bands: Mapping[str, Float[np.ndarray, " frames"]] | None = None,
) -> Markup:
    """Plot of a value of both sides over the frames of a person, with a gap where it is unknown.

    ``bands`` are half widths of bands around the lines.
    """
    half = {side: np.zeros_like(line) for side, line in lines.items()} if bands is None else bands
    ends = [line + sign * half[side] for side, line in lines.items() for sign in (-1.0, 1.0)]
    known = np.concatenate([end[np.isfinite(end)] for end in ends])
    scale = _Scale.fit(known, unit)
    num_frames = len(next(iter(lines.values())))
    # Thinned out to the pixels of the plot.
    rows = np.unique(np.linspace(0, num_frames - 1, min(num_frames, _MAX_POINTS)).round().astype(int))
    across = _LEFT + rows / max(num_frames - 1, 1) * (_WIDTH - _LEFT)
    start_s, end_s = start_frame / frame_rate_hz, (start_frame + max(num_frames - 1, 1)) / frame_rate_hz
    drawn = []
    for side, line in lines.items():
        for first, stop in find_runs(np.isfinite(line[rows])) if bands is not None else ():
            places = rows[first:stop]
            low, high = (scale.y(line[places] + sign * half[side][places]) for sign in (-1.0, 1.0))
            drawn.append(_band(across[first:stop], low, high, side))
    drawn += [element("path", d=_line(across, scale.y(line[rows])), class_=side) for side, line in lines.items()]
    of_unit = "degrees" if unit == "°" else unit
    label = f"{title} from {known.min():.0f} to {known.max():.0f} {of_unit}, left and right"
    times = f"{start_s:.1f} s", f"{end_s:.1f} s"
    return _figure(title, label, scale, times, drawn, {side: side for side in lines})


@dataclass(frozen=True, slots=True)
class _Scale:
    """Upright scale of a plot."""

    low: float
    high: float
    unit: str

    @classmethod
    def fit(cls, shown: Float[np.ndarray, " values"], unit: str) -> "_Scale":
        """Scale on which values fill the plot, unless they hardly differ."""
        middle = float(shown.max() + shown.min()) / 2
        half = 0.55 * max(float(np.ptp(shown)), _TICKS[unit][0])
        return cls(middle - half, middle + half, unit)

    def y(self, values: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
        """Places of values in the plot, downwards."""
        share = (self.high - values) / (self.high - self.low)
        return np.asarray(_TOP + share * (_HEIGHT - _BOTTOM - _TOP))

    def ticks(self) -> Float[np.ndarray, " ticks"]:
        """Round values, about four of them."""
        span, steps = self.high - self.low, _TICKS[self.unit][1]
        step = next(step for step in steps if span / step <= 4.4 or step == steps[-1])
        return np.arange(np.ceil(self.low / step), np.floor(self.high / step) + 1) * step


def _figure(
    title: str, label: str, scale: _Scale, ends: tuple[str, str], drawn: Sequence[Markup], keys: Mapping[str, str]
) -> Markup:
    """Plot with its scale.

    ``ends`` are the words at both ends of the axis across, ``keys`` the words for the colours by side.
    """
    ticks = scale.ticks()
    sign = scale.unit if len(scale.unit) == 1 else ""  # The title has a longer unit
    marks = [
        join(
            element("line", x1=_LEFT, x2=_WIDTH, y1=f"{place:.1f}", y2=f"{place:.1f}", class_="grid"),
            element("text", f"{tick + 0.0:g}{sign}", x=_LEFT - 4, y=f"{place + 4:.1f}", text_anchor="end"),
        )
        for tick, place in zip(ticks, scale.y(ticks), strict=True)
    ]
    limits = [
        element("text", ends[0], x=_LEFT, y=_HEIGHT - 3),
        element("text", ends[1], x=_WIDTH, y=_HEIGHT - 3, text_anchor="end"),
    ]
    box = f"0 0 {_WIDTH} {_HEIGHT}"
    svg = element("svg", marks, limits, drawn, viewBox=box, width=_WIDTH, height=_HEIGHT, role="img", aria_label=label)
    legend = (element("span", words, class_=f"key {side}") for side, words in keys.items())
    return element("figure", svg, element("figcaption", title, " ", legend))


def _band(
    across: Float[np.ndarray, " points"],
    low: Float[np.ndarray, " points"],
    high: Float[np.ndarray, " points"],
    side: str,
) -> Markup:
    """Area between two lines."""
    outline = [*zip(across, low, strict=True), *zip(across[::-1], high[::-1], strict=True)]
    return element("polygon", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in outline), class_=side)


def _line(across: Float[np.ndarray, " points"], places: Float[np.ndarray, " points"]) -> str:
    """Path of a line, which is broken where its place is unknown."""
    words, is_drawing = [], False
    for x, place in zip(across.tolist(), places.tolist(), strict=True):
        if np.isfinite(place):
            words.append(f"{'L' if is_drawing else 'M'}{x:.1f} {place:.1f}")
        is_drawing = bool(np.isfinite(place))
    return "".join(words)


NamedFigures = tuple[str, Mapping[str, Any]]
"""Name of a person, and the entry in ``metrics.json``."""

# Figure, unit and decimals of each column.
_FIGURES = {
    "Stride length": ("stride_length_m", "m", 2),
    "Step width": ("step_width_m", "m", 2),
    "Cadence": ("cadence_steps_per_min", "steps/min", 0),
    "Speed": ("speed_m_s", "m/s", 2),
    "Stance": ("stance_percent", "%", 0),
    "Double support": ("double_support_percent", "%", 0),
}
GAIT_COLUMNS = ("Person", "Side", "Strides", *_FIGURES, "Confidence")
MOVEMENT_COLUMNS = ("Person", "Movement", "Time", "Duration", "Height or depth", "Confidence")
_KINDS: Mapping[MovementKind, str] = {
    "jump": "Jump",
    "squat": "Squat",
    "sit_to_stand": "Stands up",
    "stand_to_sit": "Sits down",
}
_AMOUNTS = {
    "height_by_flight_m": "{:.2f} m by flight time",
    "height_by_hips_m": "{:.2f} m by the hips",
    "depth_m": "{:.2f} m deep",
}


def gait_rows(people: Sequence[NamedFigures]) -> list[tuple[str, ...]]:
    """Rows of ``GAIT_COLUMNS``: both sides together, left and right of each person who walks."""
    return [
        (
            name,
            side,
            str(gait[side].get("stride_time_s", {"num": 0})["num"]),
            *(_spread(gait[side].get(figure), unit, digits) for figure, unit, digits in _FIGURES.values()),
            f"{100 * gait['confidence']:.0f} %",
        )
        for name, figures in people
        if (gait := figures["gait"]) is not None
        for side in ("both", "left", "right")
    ]


def movement_rows(people: Sequence[NamedFigures]) -> list[tuple[str, ...]]:
    """Rows of ``MOVEMENT_COLUMNS``, of each person in order of time."""
    return [
        (
            name,
            _KINDS[movement["kind"]],
            f"{movement['start_s']:.2f} s",
            f"{movement['duration_s']:.2f} s",
            ", ".join(text.format(movement[figure]) for figure, text in _AMOUNTS.items() if figure in movement),
            f"{100 * movement['confidence']:.0f} %",
        )
        for name, figures in people
        for movement in figures["movements"]
    ]


BALANCE_COLUMNS = ("Person", "Height", "Range", "Deviation", "Speed", "Angular momentum", "Margin of stability")


def balance_rows(people: Sequence[NamedFigures]) -> list[tuple[str, ...]]:
    """Rows of ``BALANCE_COLUMNS``: a person each; medians, and the largest angular momentum."""

    def shown(value: float | None, unit: str, digits: int = 2) -> str:
        return "-" if value is None else f"{value:.{digits}f} {unit}"

    return [
        (
            name,
            shown(found["height_m"], "m"),
            f"{found['lowest_m']:.2f} to {found['highest_m']:.2f} m",
            shown(None if found["sigma_m"] is None else 1000 * found["sigma_m"], "mm", 1),
            shown(found["speed_m_s"], "m/s"),
            shown(found["angular_momentum_max"], "m²/s" if found["mass_kg"] is None else "kg m²/s"),
            shown(found["margin_m"], "m"),
        )
        for name, figures in people
        if (found := figures["balance"]) is not None
    ]


FORCE_COLUMNS = ("Person", "Mass", "Side", "Stances", "Vertical impulse", "Peak", "Loading rate", "Jumps by impulse")
_OF_STANCES = {"impulse_bw_s": "BW s", "peak_bw": "BW", "loading_rate_bw_s": "BW/s"}


def force_rows(people: Sequence[NamedFigures], forces: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of ``FORCE_COLUMNS``: means of each side's stances in body weights, and a row of the person's asymmetry."""
    names = {figures["id"]: name for name, figures in people}
    rows = []
    for person in forces:
        guess = ", estimated" if person["mass_is_estimated"] else ""
        mass = f"{person['mass_kg']:.0f} \N{PLUS-MINUS SIGN} {person['mass_sigma_kg']:.0f} kg{guess}"
        jumps = ", ".join(f"{jump['by_impulse_m']:.2f} m" for jump in person["jumps"])
        for side in SIDES:
            stances = [stance for stance in person["stances"] if stance["side"] == side]
            means = [
                f"{np.mean([stance[figure] for stance in stances]):.2f} {unit}" if stances else "-"
                for figure, unit in _OF_STANCES.items()
            ]
            rows.append((names[person["id"]], mass, side, str(len(stances)), *means, jumps or "-"))
        apart = [person["asymmetry_percent"][figure] for figure in _OF_STANCES]
        cells = ["-" if value is None else f"{value:+.0f} %" for value in apart]
        rows.append((names[person["id"]], "", "right less left", "", *cells, ""))
    return rows


def _spread(spread: Mapping[str, Any] | None, unit: str, digits: int) -> str:
    """Mean, and the standard deviation if there is one."""
    if spread is None:
        return "-"
    mean = f"{spread['mean']:.{digits}f}"
    return (
        f"{mean} {unit}" if spread["std"] is None else f"{mean} \N{PLUS-MINUS SIGN} {spread['std']:.{digits}f} {unit}"
    )
