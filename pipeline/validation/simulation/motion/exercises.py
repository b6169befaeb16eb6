"""Exercises with exact truth: countermovement jumps, squats, and sitting down on a seat and standing up again."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from pipeline.validation.simulation.motion.locomotion import smoothstep

_GRAVITY_M_S2 = 9.81
# Dip before a jump and after its landing, in lengths of the leg; a leg of this length turns the take-off's velocity
# into that of the drop.
_DIP, _ABSORB, _USUAL_LEG_M = 0.28, 0.22, 0.85
# Times of a jump: standing, down, up to the take-off; after the landing down, up and standing.
_STANDING_S, _DOWN_S, _PUSH_S, _ABSORB_S, _RISE_S = 0.5, 0.45, 0.22, 0.22, 0.5
# Time to go down and as long to come up, at the bottom, and between two repetitions.
_SQUAT_S, _SQUAT_BOTTOM_S, _SQUAT_PAUSE_S = 1.0, 0.2, 0.6
_SITTING_S, _SEATED_S, _BETWEEN_S = 1.1, 1.2, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Exercise:
    """Motion of the hips, the feet and the trunk over time, from standing to standing."""

    drop: Float[np.ndarray, " times"]  # Drop of the hips, in lengths of the leg
    hop_m: Float[np.ndarray, " times"]  # Height of the feet above the floor
    back_m: Float[np.ndarray, " times"]  # Displacement of the hips to the back, beside that of the lean
    lean_rad: Float[np.ndarray, " times"]  # Lean of the trunk forward
    raised: Float[np.ndarray, " times"]  # Arms from hanging (0) to stretched ahead (1)


def countermovement_jumps(time_s: Float[np.ndarray, " times"], rng: np.random.Generator) -> Exercise:
    """Complete jumps of one height: down, push, flight, landing.

    The hips reach the take-off with the velocity with which they fly, and land with it.
    """
    takeoff_m_s = rng.uniform(1.7, 2.7)
    flight_s = 2 * takeoff_m_s / _GRAVITY_M_S2
    rate = takeoff_m_s / _USUAL_LEG_M
    waits_s = (_STANDING_S, _DOWN_S, _PUSH_S, flight_s, _ABSORB_S, _RISE_S)
    knots_s = np.concatenate([[0.0], np.cumsum(waits_s)])
    drop = CubicHermiteSpline(knots_s, [0.0, 0.0, _DIP, 0.0, 0.0, _ABSORB, 0.0], [0.0, 0.0, 0.0, -rate, rate, 0.0, 0.0])
    since_s = _repeated(time_s, knots_s[-1])
    air_s = np.clip(since_s - knots_s[3], 0.0, flight_s)
    is_flying = (since_s > knots_s[3]) & (since_s < knots_s[4])
    dropped = np.where(is_flying, 0.0, drop(since_s))
    hop_m = takeoff_m_s * air_s - _GRAVITY_M_S2 * air_s**2 / 2
    raised = smoothstep((since_s - knots_s[2]) / _PUSH_S) * smoothstep((knots_s[5] - since_s) / 0.3)
    return Exercise(dropped, hop_m, np.zeros_like(time_s), 1.2 * dropped, raised)


def squats(time_s: Float[np.ndarray, " times"], rng: np.random.Generator) -> Exercise:
    """Complete squats of one depth."""
    depth, tempo = rng.uniform(0.36, 0.5), rng.uniform(0.8, 1.3)
    share = _down_and_up(time_s, tempo * _SQUAT_S, _SQUAT_BOTTOM_S, _SQUAT_PAUSE_S)
    zero = np.zeros_like(time_s)
    return Exercise(depth * share, zero, 0.05 * share, 0.6 * share, share)


def sits(time_s: Float[np.ndarray, " times"], rng: np.random.Generator) -> Exercise:
    """Sit down on a seat behind the feet, with the trunk upright at last, and stand up again; complete times."""
    depth, tempo = rng.uniform(0.44, 0.5), rng.uniform(0.8, 1.3)
    share = _down_and_up(time_s, tempo * _SITTING_S, tempo * _SEATED_S, _BETWEEN_S)
    # The trunk leans ahead on the way, and is upright on the seat.
    lean_rad = 0.7 * np.sin(np.pi * share) + 0.1 * share
    return Exercise(depth * share, np.zeros_like(time_s), 0.38 * share, lean_rad, 0.3 * share)


def _down_and_up(time_s: np.ndarray, way_s: float, bottom_s: float, pause_s: float) -> Float[np.ndarray, " times"]:
    """Share of the way down, of complete repetitions."""
    since_s = _repeated(time_s, pause_s + 2 * way_s + bottom_s) - pause_s
    return smoothstep(since_s / way_s) * smoothstep((2 * way_s + bottom_s - since_s) / way_s)


def _repeated(time_s: np.ndarray, cycle_s: float) -> np.ndarray:
    """Time since the start of the repetition; 0 after the last complete one."""
    whole = np.floor((time_s[-1] + 1e-9) / cycle_s)
    return np.where(time_s < whole * cycle_s, time_s % cycle_s, 0.0)
