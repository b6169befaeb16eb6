"""Draws ``docs/images/preset-*.svg``: the rest pose of each BVH preset from the front, with names, axes and unit.

Also ``docs/images/hand.svg``: the left hand of a skeleton with fingers from above, with the default preset's names.

``.venv/bin/python docs/draw_presets.py``. Everything in a picture of a preset is read out of a file that was written
with the preset.
"""

import tempfile
from pathlib import Path
from xml.sax.saxutils import escape

import bvhio
import numpy as np

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS
from pipeline.export.writers import bvh
from pipeline.motion.skeleton.model import SKELETON, WHOLE_SKELETON, forward_kinematics, parent_indices

STATURE_M = 1.75
WIDTH_PX, HEIGHT_PX, SCALE_PX_M = 760, 480, 205
FLOOR_PX, MIDDLE_PX = 440, 380
LABEL_STEP_PX = 19
HAND_WIDTH_PX, HAND_HEIGHT_PX, HAND_SCALE_PX_M = 900, 320, 2000
WRIST_PX = (90, 110)
INK, BONE, LABEL, FAINT = "#1d2422", "#2f6f6a", "#1d2422", "#b9c1bd"


def standing() -> SkeletonMotion:
    """An adult in the skeleton's rest pose, toes on the floor."""
    lengths_m = np.array([STATURE_M * joint.stature_share for joint in SKELETON])
    legs_m = STATURE_M * (0.245 + 0.246 + 0.104 * np.sin(np.radians(22.0)))
    still = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(SKELETON), 1))
    return SkeletonMotion(1, "person-1", 0, 25.0, lengths_m, np.array([[0.0, 0.0, legs_m]]), still, ())


def read_rest(preset: Preset) -> tuple[dict[str, np.ndarray], list[tuple[str, str]], list[str]]:
    """Places of the file's joints in its rest pose, its bones as pairs of names, and the channels of its root."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rest.bvh"
        path.write_bytes(b"".join(bvh.encode(standing(), PRESETS[preset])))
        file = bvhio.readAsBvh(str(path))
        root = bvhio.readAsHierarchy(str(path)).loadRestPose(recursive=True)
    at = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
    bones = [(joint.Parent.Name, joint.Name) for joint, _, _ in root.layout() if joint.Parent is not None]
    return at, bones, list(file.Root.Channels)


def draw(preset: Preset) -> str:
    """One picture."""
    at, bones, channels = read_rest(preset)
    convention = PRESETS[preset]
    axes = convention.file_from_world
    up, left = axes @ [0.0, 0.0, 1.0], axes @ [1.0, 0.0, 0.0]
    floor = min(float(place @ up) for place in at.values())

    # Seen from the front the left side is on the right.
    def on_page(place: np.ndarray) -> tuple[float, float]:
        place_m = place / convention.units_per_m
        height_m = place_m @ up - floor / convention.units_per_m + 0.08
        return MIDDLE_PX + SCALE_PX_M * float(place_m @ left), FLOOR_PX - SCALE_PX_M * float(height_m)

    places = {name: on_page(place) for name, place in at.items()}
    drawn = [
        f'<line x1="60" x2="{WIDTH_PX - 60}" y1="{FLOOR_PX}" y2="{FLOOR_PX}" stroke="{FAINT}" stroke-width="2"/>',
        *(
            f'<line x1="{places[a][0]:.1f}" y1="{places[a][1]:.1f}" x2="{places[b][0]:.1f}" y2="{places[b][1]:.1f}" '
            f'stroke="{BONE}" stroke-width="6" stroke-linecap="round"/>'
            for a, b in bones
        ),
        *(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{INK}"/>' for x, y in places.values()),
        *_labels(places),
        *_axes(convention.file_from_world),
    ]
    metre = f"1 m is {convention.units_per_m:g} units"
    order = " ".join(channel[0] for channel in channels if channel.endswith("rotation"))
    title = f"{preset}: {metre}, rotations in the order {order}"
    drawn.append(f'<text x="20" y="28" font-size="17" font-weight="600" fill="{INK}">{escape(title)}</text>')
    return _page(drawn, WIDTH_PX, HEIGHT_PX)


def draw_hand() -> str:
    """The left hand in the rest pose from above: its fingers point to the right of the page, its thumb down."""
    lengths_m = np.array([STATURE_M * joint.stature_share for joint in WHOLE_SKELETON])
    still = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(WHOLE_SKELETON), 1))
    positions_m = forward_kinematics(SkeletonMotion(1, "", 0, 25.0, lengths_m, np.zeros((1, 3)), still, ()))[0]
    names = [joint.name for joint in WHOLE_SKELETON]
    offset_px = (positions_m - positions_m[names.index("LeftHand")])[:, :2] * [HAND_SCALE_PX_M, -HAND_SCALE_PX_M]
    x, y = (WRIST_PX + offset_px).T
    fingers = [
        (index, joint)
        for index, joint in enumerate(WHOLE_SKELETON)
        if joint.name.startswith("LeftHand") and joint.landmarks
    ]
    parents = parent_indices(len(WHOLE_SKELETON))
    drawn = [
        f'<line x1="{x[parents[index]]:.1f}" y1="{y[parents[index]]:.1f}" x2="{x[index]:.1f}" y2="{y[index]:.1f}" '
        f'stroke="{FAINT if joint.name.endswith("1") else BONE}" stroke-width="6" stroke-linecap="round"/>'
        for index, joint in fingers[1:]
    ]
    for index, joint in fingers:
        drawn.append(f'<circle cx="{x[index]:.1f}" cy="{y[index]:.1f}" r="5" fill="{INK}"/>')
        if joint.name.endswith("3End"):
            first = joint.name.removesuffix("3End")
            drawn.append(
                f'<text x="{x[index] + 14:.1f}" y="{y[index] + 5:.1f}" font-size="13" fill="{LABEL}">'
                f"{first}1, {first}2, {first}3</text>"
            )
    wrist_x, wrist_y = WRIST_PX
    drawn.append(f'<text x="{wrist_x - 70}" y="{wrist_y - 14}" font-size="13" fill="{LABEL}">LeftHand</text>')
    return _page(drawn, HAND_WIDTH_PX, HAND_HEIGHT_PX)


def _page(drawn: list[str], width_px: int, height_px: int) -> str:
    body = "\n".join(drawn)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width_px} {height_px}" font-family="sans-serif">\n'
        f'<rect width="{width_px}" height="{height_px}" fill="#fff"/>\n{body}\n</svg>\n'
    )


def _labels(places: dict[str, tuple[float, float]]) -> list[str]:
    """Names in two columns with thin lines to their joints; joints of the left side and the middle are on the right."""
    drawn = []
    for is_right_column in (True, False):
        column = sorted(
            (place for place in places.items() if (place[1][0] > MIDDLE_PX - 1) == is_right_column),
            key=lambda named: named[1][1],
        )
        heights = [max(70.0, y) for _, (_, y) in column]
        for number in range(1, len(heights)):
            heights[number] = max(heights[number], heights[number - 1] + LABEL_STEP_PX)
        x_label, anchor = (WIDTH_PX - 165, "start") if is_right_column else (165, "end")
        for (name, (x, y)), height in zip(column, heights, strict=True):
            drawn.append(
                f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{x_label}" y2="{height - 4:.1f}" stroke="{FAINT}"/>'
                f'<text x="{x_label + (5 if is_right_column else -5)}" y="{height:.1f}" text-anchor="{anchor}" '
                f'font-size="13" fill="{LABEL}">{escape(name)}</text>'
            )
    return drawn


def _axes(file_from_world: np.ndarray) -> list[str]:
    """The file's axes as they lie on the page; a dot comes out of it, a cross goes into it."""
    x0, y0, length = 60, 105, 40
    drawn = []
    right_up_front = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]) @ file_from_world.T
    for name, color, (right, up, front) in zip("XYZ", ("#c23b22", "#2b8a3e", "#1f5fbf"), right_up_front.T, strict=True):
        if abs(front) > 0.5:
            inside = (
                f'<circle cx="{x0}" cy="{y0}" r="3" fill="{color}"/>'
                if front > 0
                else f'<path d="M{x0 - 5} {y0 - 5}l10 10m0-10l-10 10" stroke="{color}"/>'
            )
            drawn.append(
                f'<circle cx="{x0}" cy="{y0}" r="8" fill="#fff" stroke="{color}" stroke-width="2"/>{inside}'
                f'<text x="{x0 - 24}" y="{y0 + 6}" font-size="15" font-weight="600" fill="{color}">{name}</text>'
            )
        else:
            x1, y1 = x0 + length * right, y0 - length * up
            drawn.insert(
                0,
                f'<line x1="{x0}" y1="{y0}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="3"/>'
                f'<text x="{x1 + 8 * right - 5:.1f}" y="{y1 - 8 * up + 6 * right:.1f}" font-size="15" '
                f'font-weight="600" fill="{color}">{name}</text>',
            )
    return drawn


if __name__ == "__main__":
    folder = Path(__file__).with_name("images")
    for preset in PRESETS:
        folder.joinpath(f"preset-{preset}.svg").write_text(draw(preset), encoding="utf-8")
    folder.joinpath("hand.svg").write_text(draw_hand(), encoding="utf-8")
