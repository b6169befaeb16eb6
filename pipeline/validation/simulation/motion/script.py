"""Scripts of simulated people: roles, cues and gestures as data."""

from dataclasses import dataclass
from enum import Enum


class Gesture(Enum):
    """Gesture of a person who stays in place."""

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
    HANDS = "hands"
    COUNTERMOVEMENT_JUMP = "countermovement_jump"
    SQUAT = "squat"
    SIT = "sit"


@dataclass(frozen=True, slots=True)
class Walk:
    """Walk, or run from 2.7 m/s on, to a point on the floor, in a curve that starts in the person's heading."""

    to_m: tuple[float, float]
    speed_m_s: float = 1.2


@dataclass(frozen=True, slots=True)
class Turn:
    """Turn on the spot, the shorter way, to a heading; 0 is along X, positive angles are to the left."""

    facing_rad: float


@dataclass(frozen=True, slots=True)
class Stay:
    """Stay in place with a gesture; ``hand_m`` is the world position where hands meet (``SHAKE_HANDS``, ``CLAP``)."""

    duration_s: float
    gesture: Gesture = Gesture.IDLE
    hand_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Away:
    """Be absent for at least a second, and return at another point."""

    duration_s: float
    to_m: tuple[float, float]
    facing_rad: float


Cue = Walk | Turn | Stay | Away


@dataclass(frozen=True, slots=True)
class Role:
    """Start and cues of a person, who stays in place after the last cue."""

    start_m: tuple[float, float]
    facing_rad: float
    cues: tuple[Cue, ...]
