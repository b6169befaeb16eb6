"""Gestures: motion of arms, trunk and hips of people who stay in place.

Wrist targets are relative to the shoulder, in lengths of the arm, along the upright trunk's axes (ahead, left, up).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from pipeline.validation.simulation.motion.locomotion import smoothstep
from pipeline.validation.simulation.motion.script import Gesture

_GRAVITY_M_S2 = 9.81
# Dip before a jump and after its landing, in lengths of the leg; a leg of this length turns the take-off's velocity
# into the velocity of the drop.
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
    back_m: Float[np.ndarray, " times"]  # Displacement of the hips to the back, beside the lean's
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


BLEND_S = 0.35
"""Time of the transition into a gesture and out of it."""

_LEFT = np.array([1.0, -1.0])
_EXERCISES: Mapping[Gesture, Callable[[np.ndarray, np.random.Generator], Exercise]] = {
    Gesture.COUNTERMOVEMENT_JUMP: countermovement_jumps,
    Gesture.SQUAT: squats,
    Gesture.SIT: sits,
}


@dataclass(frozen=True, slots=True, eq=False)
class GestureMotion:
    """Gesture over time, from rest to rest."""

    wrists: Float[np.ndarray, "times 2 3"]  # Wrist targets
    arms: Float[np.ndarray, "times 2"]  # Weight of each arm's target, from 0 to 1
    drop: Float[np.ndarray, " times"]  # Drop of the hips, in lengths of the leg
    hop_m: Float[np.ndarray, " times"]  # Height of the feet above the floor
    # Lean of the trunk forward, and its rotation to the left
    lean_rad: Float[np.ndarray, " times"]
    twist_rad: Float[np.ndarray, " times"]
    back_m: Float[np.ndarray, " times"] | float = 0.0  # Displacement of the hips to the back, beside the lean's


def overlay(
    gesture: Gesture, time_s: Float[np.ndarray, " times"], hand: Float[np.ndarray, " 3"], rng: np.random.Generator
) -> GestureMotion:
    """Compute a gesture over time.

    ``time_s`` is since its start, and the last entry its end; right hands meet at ``hand``, a target of the wrist.
    """
    zero = np.zeros_like(time_s)
    blend = smoothstep(time_s / BLEND_S) * smoothstep((time_s[-1] - time_s) / BLEND_S)
    match gesture:
        case Gesture.IDLE:
            return GestureMotion(np.zeros((len(time_s), 2, 3)), np.zeros((len(time_s), 2)), zero, zero, zero, zero)
        case Gesture.WAVE:
            arms = rng.permutation([0.0, 1.0])
            sway = 0.2 * np.sin(2 * np.pi * rng.uniform(1.3, 1.9) * time_s)
            wrists = _both(0.25 + zero, 0.45 + sway, 0.6 + zero)
        case Gesture.POINT:
            arms = rng.permutation([0.0, 1.0])
            level = rng.uniform(-0.2, 0.3)
            wrists = _both(0.93 + zero, 0.15 + 0.05 * np.sin(time_s), level + zero)
        case Gesture.TALK:
            arms = np.ones(2)
            wrists = _both(0.45 + zero, 0.05 + zero, -0.45 + zero) + 0.1 * smooth_noise(time_s, (2, 3), 0.4, 1.6, rng)
        case Gesture.SHAKE_HANDS:
            arms = np.array([0.0, 1.0])
            wrists = np.tile(hand, (len(time_s), 2, 1))
            wrists[..., 2] += 0.05 * (blend * np.sin(2 * np.pi * 2.5 * time_s))[:, None]
        case Gesture.CLAP:
            arms = np.array([0.0, 1.0])
            # The right hands meet three times in two seconds.
            back = 0.2 * (1 - np.cos(2 * np.pi * 1.5 * time_s))
            wrists = np.tile(hand, (len(time_s), 2, 1)) - back[:, None, None] * np.array([1.0, 0.0, 0.0])
        case Gesture.HUG:
            # Arms around another person at touching distance.
            arms = np.ones(2)
            wrists = _both(0.75 + zero, -0.12 + zero, -0.15 + 0.03 * np.sin(2 * np.pi * 0.7 * time_s))
        case Gesture.PUNCH:
            return _punch(time_s, blend)
        case Gesture.SWING:
            return _swing(time_s, blend)
        case Gesture.CROUCH:
            depth = rng.uniform(0.3, 0.45)
            slow = smoothstep(time_s / 0.8) * smoothstep((time_s[-1] - time_s) / 0.8)
            wrists = _both(0.5 + zero, -0.05 + zero, -0.6 + zero)
            return GestureMotion(wrists, _share(slow, np.ones(2)), depth * slow, zero, 0.6 * slow, zero)
        case Gesture.JUMP | Gesture.COUNTERMOVEMENT_JUMP | Gesture.SQUAT | Gesture.SIT:
            return _jump(time_s, blend, rng) if gesture is Gesture.JUMP else _exercise(gesture, time_s, blend, rng)
        case Gesture.HANDS:
            # Hands in front of the chest, apart from each other, that show postures of the fingers.
            arms = np.ones(2)
            wrists = _both(0.5 + zero, 0.1 + zero, -0.1 + zero) + 0.07 * smooth_noise(time_s, (2, 3), 0.2, 0.9, rng)
    return GestureMotion(wrists, _share(blend, arms), zero, zero, zero, zero)


def smooth_noise(
    time_s: Float[np.ndarray, " times"], shape: tuple[int, ...], low_hz: float, high_hz: float, rng: np.random.Generator
) -> np.ndarray:
    """Independent noise (times, *shape) of unit variance, as a sum of four waves."""
    rate_hz = rng.uniform(low_hz, high_hz, (4, *shape))
    phase = rng.uniform(0, 2 * np.pi, (4, *shape))
    waves = np.sin(2 * np.pi * rate_hz * time_s.reshape(-1, 1, *(1 for _ in shape)) + phase)
    return np.asarray(waves.sum(1) / np.sqrt(2))


def _both(ahead: np.ndarray, outward: np.ndarray, up: np.ndarray) -> Float[np.ndarray, "times 2 3"]:
    """Targets of both arms, the right arm's mirrored."""
    sides = outward[:, None] * _LEFT
    return np.stack([np.stack([ahead] * 2, axis=-1), sides, np.stack([up] * 2, axis=-1)], axis=-1)


def _share(blend: np.ndarray, arms: np.ndarray) -> Float[np.ndarray, "times 2"]:
    return blend[:, None] * arms


def _exercise(gesture: Gesture, time_s: np.ndarray, blend: np.ndarray, rng: np.random.Generator) -> GestureMotion:
    """Gesture of an exercise: arms hang, or are stretched ahead."""
    exercise = _EXERCISES[gesture](time_s, rng)
    raised = exercise.raised
    wrists = _both(0.1 + 0.75 * raised, 0.15 - 0.1 * raised, -0.95 + 0.85 * raised)
    arms, twist_rad = _share(blend, np.ones(2)), np.zeros_like(raised)
    return GestureMotion(
        wrists, arms, exercise.drop, exercise.hop_m, exercise.lean_rad, twist_rad, back_m=exercise.back_m
    )


def _punch(time_s: np.ndarray, blend: np.ndarray) -> GestureMotion:
    """Alternating straight punches out of a guard, 0.1 s to the target."""
    cycle_s, stroke_s = 0.9, 0.2
    zero = np.zeros_like(time_s)
    # The right arm's stroke is half a cycle later than the left arm's.
    since_s = np.stack([time_s % cycle_s, (time_s + cycle_s / 2) % cycle_s], axis=-1)
    stroke = np.where(since_s < stroke_s, np.sin(np.pi * since_s / stroke_s) ** 2, 0.0)
    guard, hit = _both(0.3 + zero, -0.05 + zero, 0.0 + zero), _both(0.98 + zero, -0.1 + zero, 0.1 + zero)
    wrists = guard + stroke[..., None] * (hit - guard)
    return GestureMotion(
        wrists, _share(blend, np.ones(2)), 0.06 * blend, zero, 0.1 * blend, 0.3 * blend * (stroke @ -_LEFT)
    )


def _swing(time_s: np.ndarray, blend: np.ndarray) -> GestureMotion:
    """Strikes of both hands from above the right shoulder to the left hip in 0.25 s, back in 0.8 s."""
    since_s = time_s % 1.4
    done = smoothstep(since_s / 0.25) - smoothstep((since_s - 0.45) / 0.8)
    up, left = 1.0 - 1.6 * done, -0.7 + 1.4 * done
    wrist = 0.85 * np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=-1)
    # The hands meet in front of the chest, about a third of an arm inwards of each shoulder.
    wrists = wrist[:, None] - 0.3 * _LEFT[:, None] * np.array([0.0, 1.0, 0.0])
    zero = np.zeros_like(time_s)
    return GestureMotion(
        wrists, _share(blend, np.ones(2)), 0.05 * blend, zero, 0.1 * blend, blend * (0.5 * done - 0.25)
    )


def _jump(time_s: np.ndarray, blend: np.ndarray, rng: np.random.Generator) -> GestureMotion:
    """Repeated jumps: squat, flight and landing."""
    takeoff_m_s = rng.uniform(1.8, 2.7)
    flight_s, squat_s, land_s = 2 * takeoff_m_s / _GRAVITY_M_S2, 0.5, 0.45
    cycle_s = squat_s + flight_s + land_s
    # Only complete jumps.
    num_jumps = np.floor(time_s[-1] / cycle_s)
    since_s = np.where(time_s < num_jumps * cycle_s, time_s % cycle_s, 0.0)
    air_s = np.clip(since_s - squat_s, 0.0, flight_s)
    hop_m = takeoff_m_s * air_s - _GRAVITY_M_S2 * air_s**2 / 2
    squat = np.sin(np.pi * np.clip(since_s / squat_s, 0, 1)) ** 2
    land = np.sin(np.pi * np.clip((since_s - squat_s - flight_s) / land_s, 0, 1)) ** 2
    drop = 0.22 * squat + 0.18 * land
    raised = smoothstep((since_s - 0.7 * squat_s) / 0.25) * smoothstep((cycle_s - land_s - since_s) / 0.3 + 1)
    zero = np.zeros_like(time_s)
    wrists = _both(-0.3 + 0.8 * raised, 0.2 + zero, -0.85 + 1.2 * raised)
    return GestureMotion(wrists, _share(blend, np.ones(2)), drop, hop_m, 0.3 * (squat + land), zero)
