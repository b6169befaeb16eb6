"""What simulated people are told to do: scripts are data."""

from dataclasses import dataclass
from enum import Enum


class Gesture(Enum):
    """What somebody does who stays in place."""

    IDLE = "idle"
    WAVE = "wave"
    POINT = "point"
    TALK = "talk"
    SHAKE_HANDS = "shake_hands"
    CLAP = "clap"
    HUG = "hug"
    PUNCH = "punch"
    SWING = "swing"
    CROUCH = "crouch"
    JUMP = "jump"


@dataclass(frozen=True, slots=True)
class Walk:
    """Walk to a place on the floor, or run there from 2.7 m/s on, in a curve that begins where the person faces."""

    to_m: tuple[float, float]
    speed_m_s: float = 1.2


@dataclass(frozen=True, slots=True)
class Turn:
    """Turn on the spot, the shorter way; 0 faces along X, positive angles are to the left."""

    facing_rad: float


@dataclass(frozen=True, slots=True)
class Stay:
    """Stay in place and do something; ``hand_m`` is where hands meet in the world (``SHAKE_HANDS``, ``CLAP``)."""

    duration_s: float
    gesture: Gesture = Gesture.IDLE
    hand_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Away:
    """Be absent for at least a second, and come back elsewhere."""

    duration_s: float
    to_m: tuple[float, float]
    facing_rad: float


Cue = Walk | Turn | Stay | Away


@dataclass(frozen=True, slots=True)
class Role:
    """A person's start and cues; whoever has no cue left stays in place."""

    start_m: tuple[float, float]
    facing_rad: float
    cues: tuple[Cue, ...]
