"""Performance of scripts: body and motion of a person, and joint positions at any time."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from pipeline.core.joints import COCO_17, FINGER_JOINTS, SIDES, JointSet
from pipeline.motion.body_segments import WORLD
from pipeline.validation.simulation.motion import body as bodies
from pipeline.validation.simulation.motion.feet import Feet, heels_and_toes, random_foot_shape, roll
from pipeline.validation.simulation.motion.gestures import GestureMotion, overlay, smooth_noise
from pipeline.validation.simulation.motion.hands import Hands, finger_motion, fingers, random_scale
from pipeline.validation.simulation.motion.locomotion import GRID_HZ, Route, Steps, ankles, follow_steps, lay_out
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay

# Wrists of relaxed arms relative to the shoulders, in lengths of the arm (ahead, left, up).
_HANGING = np.array([[0.06, 0.16, -0.95], [0.06, -0.16, -0.95]])
_SIDES = np.array([1.0, -1.0])
_PAIRS = [COCO_17.indices((f"left_{joint}", f"right_{joint}")) for joint in ("shoulder", "elbow", "wrist", "ankle")]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPerson:
    """Body and motion of a person on the grid of ``GRID_HZ``, from time 0 on."""

    # Body, its pose, and whether the person is present
    body: bodies.Proportions
    pose: bodies.Pose
    present: Bool[np.ndarray, " times"]
    # Orientation of the feet, and motion of the hands; ``None`` if their joints are not simulated
    feet: Feet | None = None
    hands: Hands | None = None
    steps: tuple[Steps, Steps] | None = None  # Steps of the left and of the right foot
    hop_m: Float[np.ndarray, " times"] | None = None  # Height of the feet above the floor in jumps


def perform(role: Role, duration_s: float, rng: np.random.Generator, joints: JointSet = COCO_17) -> SimulatedPerson:
    """Perform a role: draw a body and compute its motion.

    ``duration_s``: length of the motion; later cues are cut off. ``rng``: source of the body and of all variation that
    the role leaves open. Feet and hands have a stream of their own: the rest of the body moves as without them, except
    for shins and ankles of feet that roll. ``joints``: joints to simulate: ``COCO_17``, ``BODY_FEET`` or
    ``WHOLE_BODY``.
    """
    (own,) = rng.spawn(1)
    body = bodies.random_proportions(rng)
    route, rests, cue_rows = lay_out(role, duration_s)
    steps = follow_steps(route, rests, body)
    feet_m = ankles(steps, body)
    acting = _overlays(role, route, cue_rows, body, rng)
    time_s = np.arange(len(route.steps)) / GRID_HZ
    # Strides a second: arms swing in proportion, and hang while standing.
    pace = gaussian_filter1d(np.gradient(route.steps) * GRID_HZ / 2, 0.15 * GRID_HZ, mode="nearest")
    pace = np.where(route.present, np.minimum(pace, 1.2), 0.0)
    stride = np.pi * route.steps
    lean_rad = acting.lean_rad + 0.04 + 0.06 * pace + 0.02 * smooth_noise(time_s, (), 0.05, 0.3, rng)
    twist_rad = acting.twist_rad + 0.1 * pace * np.cos(stride) + 0.03 * smooth_noise(time_s, (), 0.05, 0.3, rng)
    gaze_rad = np.array([0.3, 0.1]) * smooth_noise(time_s, (2,), 0.05, 0.3, rng)
    feet_m[..., 2] += acting.hop_m[:, None]
    person = SimulatedPerson(
        body=body,
        pose=bodies.Pose(
            hips_m=_hips(route, feet_m, body, acting, pace),
            yaw_rad=route.yaw_rad,
            lean_rad=lean_rad,
            twist_rad=twist_rad,
            gaze_rad=gaze_rad,
            ankles_m=feet_m,
            wrists=_wrists(acting, pace, stride) + 0.015 * smooth_noise(time_s, (2, 3), 0.1, 0.5, rng),
        ),
        present=route.present,
        steps=steps,
        hop_m=acting.hop_m,
    )
    if len(joints.names) > len(COCO_17.names):
        feet, rolled_m = roll(steps, route, acting.hop_m, body, random_foot_shape(body, own))
        person = replace(person, pose=replace(person.pose, ankles_m=rolled_m), feet=feet)
    if not FINGER_JOINTS.isdisjoint(joints.names):
        scale = random_scale(body, own)
        angles_rad = finger_motion(role.cues, cue_rows, len(route.steps), own)
        person = replace(person, hands=Hands(scale, angles_rad))
    return person


def joints_at(person: SimulatedPerson, time_s: Float[np.ndarray, " times"]) -> Float[np.ndarray, "times joints 3"]:
    """World positions in metres of the joints for which the person was performed, NaN while the person is absent."""
    now = _at(person, time_s)
    joints_m = bodies.pose_joints(person.body, now.pose)
    shoulders_m, elbows_m, wrists_m, ankles_m = (joints_m[:, pair] for pair in _PAIRS)
    if now.feet is not None:
        joints_m = np.concatenate([joints_m, heels_and_toes(now.feet, ankles_m, person.body)], axis=1)
    if now.hands is not None:
        joints_m = np.concatenate([joints_m, fingers(now.hands, shoulders_m, elbows_m, wrists_m)], axis=1)
    return np.where(now.present[:, None, None], joints_m, np.nan)


def segments_at(
    person: SimulatedPerson, time_s: Float[np.ndarray, " times"]
) -> dict[str, Float[np.ndarray, "times 3 3"]]:
    """Exact orientations ``world_from_segment`` of the segments of ``pipeline.motion.angles``, by name.

    NaN while the person is absent. Feet are among them if they are simulated; hands, which hold no pose of their own,
    are not.
    """
    now = _at(person, time_s)
    segments = bodies.segment_frames(now.pose, bodies.pose_joints(person.body, now.pose))
    if now.feet is not None:
        for foot, side in enumerate(SIDES):
            segments[f"{side}_foot"] = bodies.turned(now.feet.yaw_rad[:, foot], now.feet.pitch_rad[:, foot]) @ WORLD
    return {name: np.where(now.present[:, None, None], turns, np.nan) for name, turns in segments.items()}


def _at(person: SimulatedPerson, time_s: Float[np.ndarray, " times"]) -> SimulatedPerson:
    """Person with pose, presence, feet and hands at given times in place of the grid's, without steps and hops."""
    row = np.clip(time_s * GRID_HZ, 0, len(person.present) - 1)
    lower = np.minimum(row.astype(int), len(person.present) - 2)
    share = row - lower

    def between(values: np.ndarray) -> np.ndarray:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[lower] * (1 - weight) + values[lower + 1] * weight)

    feet, hands = person.feet, person.hands
    if feet is not None:
        feet = replace(feet, yaw_rad=between(feet.yaw_rad), pitch_rad=between(feet.pitch_rad))
    if hands is not None:
        hands = replace(hands, angles_rad=between(hands.angles_rad))
    return replace(
        person,
        pose=bodies.Pose(*(between(getattr(person.pose, field.name)) for field in fields(bodies.Pose))),
        present=person.present[lower] & person.present[lower + 1],
        steps=None,
        hop_m=None,
        feet=feet,
        hands=hands,
    )


def _overlays(
    role: Role, route: Route, cue_rows: list[slice], body: bodies.Proportions, rng: np.random.Generator
) -> GestureMotion:
    """Concatenate the gestures of all cues at their rows; zero elsewhere."""
    num_rows = len(route.steps)
    wrists, arms = np.zeros((num_rows, 2, 3)), np.zeros((num_rows, 2))
    drop, hop_m, lean_rad, twist_rad, back_m = np.zeros((5, num_rows))
    for cue, planned in zip(role.cues, cue_rows, strict=True):
        rows = slice(*planned.indices(num_rows))
        if not isinstance(cue, Stay) or cue.gesture is Gesture.IDLE or rows.start >= rows.stop:
            continue
        time_s = np.arange(planned.stop - planned.start) / GRID_HZ
        gesture = overlay(cue.gesture, time_s, _hand(cue, route, rows.start, body), rng)
        kept = slice(rows.stop - rows.start)
        for whole, part in (
            (wrists, gesture.wrists),
            (arms, gesture.arms),
            (drop, gesture.drop),
            (hop_m, gesture.hop_m),
            (lean_rad, gesture.lean_rad),
            (twist_rad, gesture.twist_rad),
            (back_m, np.broadcast_to(gesture.back_m, time_s.shape)),
        ):
            whole[rows] = part[kept]
    return GestureMotion(wrists, arms, drop, hop_m, lean_rad, twist_rad, back_m)


def _hand(cue: Stay, route: Route, row: int, body: bodies.Proportions) -> Float[np.ndarray, " 3"]:
    """Wrist target at which hands meet, relative to the right shoulder of the upright person."""
    if cue.hand_m is None:
        return np.array([0.7, 0.1, -0.4])
    world_from_upright = bodies.turned(route.yaw_rad[[row]], np.zeros(1))[0]
    shoulder_m = np.array([*route.xy_m[row], body.shoulder_height_m])
    shoulder_m -= body.shoulder_width_m / 2 * world_from_upright[:, 1]
    return np.asarray((np.asarray(cue.hand_m) - shoulder_m) @ world_from_upright / body.arm_m)


def _wrists(acting: GestureMotion, pace: np.ndarray, stride: np.ndarray) -> Float[np.ndarray, "times 2 3"]:
    """Wrist targets of hanging arms that swing against the legs, blended with gestures."""
    # The left foot lands ahead at stride 0, where the left arm is behind.
    swing = -0.42 * (pace * np.cos(stride))[:, None] * _SIDES
    hanging = np.tile(_HANGING, (len(pace), 1, 1))
    ahead, up = hanging[..., 0].copy(), hanging[..., 2].copy()
    hanging[..., 0] = ahead * np.cos(swing) - up * np.sin(swing)
    hanging[..., 2] = ahead * np.sin(swing) + up * np.cos(swing)
    # A bent elbow lifts the hand when it is ahead.
    hanging[..., 2] += 0.25 * np.maximum(swing, 0.0)
    share = acting.arms[..., None]
    return np.asarray(hanging + share * (acting.wrists - hanging))


def _hips(
    route: Route, feet_m: np.ndarray, body: bodies.Proportions, acting: GestureMotion, pace: np.ndarray
) -> Float[np.ndarray, "times 3"]:
    """Centre of the hips in metres, at the height of the posture, limited by the reach of the legs."""
    world_from_hips = bodies.turned(route.yaw_rad, np.zeros_like(route.yaw_rad))
    # For balance the hips sway over the standing foot in walking, and move back in a lean.
    sway_m = 0.02 * pace * np.sin(np.pi * (route.steps - 0.1))
    back_m = 0.4 * body.trunk_m * np.sin(acting.lean_rad) + acting.back_m
    xy_m = route.xy_m + sway_m[:, None] * world_from_hips[:, :2, 1] - back_m[:, None] * world_from_hips[:, :2, 0]
    aside = body.hip_width_m / 2 * _SIDES[:, None] * world_from_hips[:, None, :2, 1]
    across_m = np.linalg.norm(xy_m[:, None] + aside - feet_m[..., :2], axis=-1)
    leg_m = bodies.STANDING_LEG * body.leg_m
    highest_m = (feet_m[..., 2] + np.sqrt(np.maximum(leg_m**2 - across_m**2, 0.0))).min(1)
    asked_m = body.ankle_height_m + leg_m - acting.drop * body.leg_m + acting.hop_m
    height_m = gaussian_filter1d(np.minimum(asked_m, highest_m), 0.04 * GRID_HZ, mode="nearest")
    return np.column_stack([xy_m, height_m])
