"""Forces in a report: vertical force of each foot over time, and forces and moments over steady strides."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import SIDES
from pipeline.export.report.biomechanics import PersonAngles, cycle_plot, plot
from pipeline.export.report.markup import Markup, element
from pipeline.motion.angles.compute import normalised_cycles
from pipeline.motion.forces.joint_moments import MOMENT_NAMES
from pipeline.motion.forces.person_forces import PersonForces

_MOMENTS = ("hip_flexion", "knee_flexion", "ankle_dorsiflexion")
_DEVIATIONS = 2.0

Lines = Mapping[str, Float[np.ndarray, " frames"]]
"""Values of each side over frames."""


def force_parts(people: Iterable[PersonAngles], frame_rate_hz: float) -> Iterable[Markup]:
    """Parts of the section on forces: for each person a plot over time and plots over strides."""
    of_people = [(person, person.forces) for person in people if person.forces is not None]
    for person, forces in of_people:
        percent = 100.0 / forces.weight
        vertical = {side: percent * forces.feet.force[:, k, 2] for k, side in enumerate(SIDES)}
        sigma = {side: _DEVIATIONS * percent * forces.feet.sigma[:, k, 2] for k, side in enumerate(SIDES)}
        if not any(np.isfinite(line).any() for line in vertical.values()):
            continue
        note = "Vertical force of each foot in % of body weight, with a band of two standard deviations."
        if forces.feet.measured.any():
            note += " Force plates measured some of it."
        if np.isfinite(forces.flight_residual):
            flight = f"{100.0 * forces.flight_residual:+.1f} % of body weight"
            note += f" Check: the mean in flights was {flight} before it was held at 0; up to 4 % is usual in jumps."
        cycles = [
            cycle_plot(title, found, unit)
            for title, unit, lines in _of_strides(forces)
            if any(map(len, (found := _cycles(person, lines)).values()))
        ]
        over = "Steady strides, from foot strike to foot strike: mean and one standard deviation."
        yield element(
            "details",
            element("summary", f"{person.name}, {forces.mass}"),
            element("p", note, class_="quiet"),
            element(
                "div", plot("Vertical force", vertical, forces.start_frame, frame_rate_hz, "%", sigma), class_="plots"
            ),
            *([element("p", over), element("div", cycles, class_="plots")] if cycles else []),
            open=len(of_people) == 1,
        )


def _of_strides(forces: PersonForces) -> Iterable[tuple[str, str, Lines]]:
    """Title, unit and lines of each plot over strides."""
    percent = 100.0 / forces.weight
    yield (
        "Vertical force, % of weight",
        "%",
        {side: percent * forces.feet.force[:, k, 2] for k, side in enumerate(SIDES)},
    )
    for name in _MOMENTS:
        columns = {side: MOMENT_NAMES.index(f"{side}_{name}") for side in SIDES}
        lines = {side: forces.joints.moment[:, k] / forces.unit_kg for side, k in columns.items()}
        yield f"Moment of {name.replace('_', ' ')}, N m/kg", "N m/kg", lines


def _cycles(person: PersonAngles, lines: Lines) -> Mapping[str, Float[np.ndarray, "cycles points"]]:
    return {
        side: normalised_cycles(
            line,
            [
                (stride.strike_row, stride.next_row)
                for stride in person.strides
                if stride.side == side and stride.is_steady
            ],
        )
        for side, line in lines.items()
    }
