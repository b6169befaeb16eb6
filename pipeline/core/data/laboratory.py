"""Records of a laboratory beside the cameras: analog channels, force plates and events, and their clock."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from pipeline.core.data.arrays import short_text
from pipeline.core.data.rigid import Rigid3

LaboratoryClock = Literal["timecode", "trigger", "contacts"]
"""How a laboratory's file is placed in time: by timecode, by a trigger channel, or by contacts and vertical force."""

Value = list[str] | np.ndarray
"""Value of a parameter of a C3D file: texts, or numbers whose dimensions are in the reverse order of the file's."""
Groups = Mapping[str, Mapping[str, Value]]
"""Values of parameters by group and name."""


class LaboratoryEvent(NamedTuple):
    """Event that the laboratory's file states, in its words."""

    label: str
    context: str
    subject: str
    time_s: float  # From the first frame of the file


class LaboratoryStart(NamedTuple):
    """Time of the first frame of a laboratory's file on the capture's clock."""

    clock: LaboratoryClock
    time_s: float
    sigma_s: float  # Standard deviation of the time


class LaboratoryCheck(NamedTuple):
    """Feet of the people beside the plates of a laboratory."""

    measured: LaboratoryStart | None  # Start by contacts and vertical force; ``None``: they do not tell it
    is_ambiguous: bool  # True if another start fits nearly as well
    mass_kg: float | None  # Mass of the person by whose weight it was measured
    apart_m: float | None  # Median distance of the centre of pressure from the nearest foot; ``None`` without load


@dataclass(frozen=True, slots=True, eq=False)
class Laboratory:
    """Content of a laboratory's C3D file.

    - ``file``, ``unit``: name of the file, and its unit of lengths: m, cm or mm.
    - ``frame_rate_hz``, ``num_frames``: frames of the file, each with ``samples_per_frame`` samples of each channel.
    - ``samples``: numbers as the file holds them: no scale or offset is applied.
    - ``groups``: groups ``ANALOG`` and ``FORCE_PLATFORM`` of the file.
    - ``world_from_laboratory``: pose of the laboratory's axes in the world, Z up; lengths in metres.
    - ``start``: time of the first frame; ``None``: it is yet to be measured from contacts, or can't be.
    - ``check``: feet beside the plates; ``None`` before the people are known.
    """

    file: str
    unit: str
    frame_rate_hz: float
    num_frames: int
    samples_per_frame: int
    samples: Float32[np.ndarray, "samples channels"]
    groups: Groups
    events: tuple[LaboratoryEvent, ...]
    world_from_laboratory: Rigid3
    start: LaboratoryStart | None = None
    check: LaboratoryCheck | None = None

    __repr__ = short_text

    @property
    def sample_rate_hz(self) -> float:
        """Samples of a channel in a second."""
        return self.frame_rate_hz * self.samples_per_frame

    def texts(self, group: str, name: str) -> list[str]:
        """Texts of a parameter and of its continuations ``NAME2``, ``NAME3``; empty without any."""
        values = continued(self.groups, group, name)
        return [text.strip() for value in values if isinstance(value, list) for text in value]

    def numbers(self, group: str, name: str) -> np.ndarray:
        """Numbers of a parameter and of its continuations, flat if there are some; empty without any."""
        values = [value for value in continued(self.groups, group, name) if isinstance(value, np.ndarray)]
        return values[0] if len(values) == 1 else np.concatenate([np.zeros(0), *(value.ravel() for value in values)])

    def channel(self, column: int) -> Float[np.ndarray, " samples"]:
        """Samples of a channel in its unit: ``(sample - OFFSET) SCALE GEN_SCALE``; 0 where that is no number."""
        raw = self.samples[:, column].astype(float)
        offset, scale, gain = (self.numbers("ANALOG", name) for name in ("OFFSET", "SCALE", "GEN_SCALE"))
        own = float(scale[column]) if column < len(scale) else 1.0
        if offset.dtype == np.uint16 and "UNSIGNED" not in self.texts("ANALOG", "FORMAT"):
            offset = offset.view(np.int16)
        zero = float(offset[column]) if column < len(offset) else 0.0
        return np.nan_to_num((raw - zero) * own * (float(gain.flat[0]) if gain.size else 1.0), posinf=0.0, neginf=0.0)


def continued(groups: Groups, group: str, name: str) -> list[Value]:
    """Values of a parameter and of its continuations ``NAME2``, ``NAME3``; empty without any."""
    values = []
    parameters, number = groups.get(group, {}), 1
    while (value := parameters.get(name if number == 1 else f"{name}{number}")) is not None:
        values.append(value)
        number += 1
    return values


@dataclass(frozen=True, slots=True, eq=False)
class ForcePlate:
    """Force plate in the world; force and moment are the floor's on the feet.

    Rows are the samples of ``Laboratory``. The centre of pressure is NaN where the plate is not loaded.
    """

    corners_m: Float[np.ndarray, "4 3"]
    force_n: Float[np.ndarray, "samples 3"]
    moment_nm: Float[np.ndarray, "samples 3"]  # About the middle of the corners
    centre_of_pressure_m: Float[np.ndarray, "samples 3"]
