"""Plots of takes: skeletons, joint angles and cameras' views by Matplotlib, and a summary in HTML."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import Problem
from pipeline.core.joints import JointSet
from pipeline.core.options.rules import require, unlisted_value
from pipeline.core.problems.request_codes import VALUE_NOT_ALLOWED
from pipeline.export.notebook.named_arrays import individuals, optional_module
from pipeline.export.report.markup import Markup, element
from pipeline.geometry.camera import project
from pipeline.motion.angles.compute import joint_angles, observable_angles
from pipeline.motion.body_segments import ANGLE_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")
_MAX_ROWS = 10
_PICTURE_PX = 160


def plot(
    take: Reconstruction,
    person: int | None,
    angle: str | None,
    camera: str | None,
    frame: int | None,
    ax: "Axes | None",
) -> "Axes":
    """See ``Reconstruction.plot``."""
    require(_problems(take, person, angle, camera, frame))
    pyplot = optional_module("matplotlib.pyplot")
    shown = [number for number, track in enumerate(take.tracks) if person in {None, track.track_id}]
    if ax is None:
        ax = pyplot.figure().add_subplot(projection=None if angle or camera else "3d")
    names = individuals(take)
    if angle is not None:
        for number in shown:
            track, motion = take.tracks[number], take.motions[number]
            angles = joint_angles(motion, track, take.joints, has_sigmas=False)
            time_s = take.timebase.start_time_s + np.array(angles.frames) / take.timebase.frame_rate_hz
            ax.plot(time_s, angles.angle_deg[:, ANGLE_NAMES.index(angle)], color=_color(number), label=names[number])
        ax.set(xlabel="time, s", ylabel=f"{angle}, degrees")
    else:
        number = _middle_frame(take, shown) if frame is None else frame
        of_people = _poses(take, shown, number)
        if camera is None:
            _draw_people(ax, of_people, take.joints, names)
        else:
            _draw_view(ax, take, camera, number, of_people, names)
        ax.set_title(f"frame {number}")
    if ax.get_legend_handles_labels()[0]:
        ax.legend()
    return ax


def _problems(
    take: Reconstruction, person: int | None, angle: str | None, camera: str | None, frame: int | None
) -> Iterator[Problem]:
    for name, value, values in (
        ("person", person, [track.track_id for track in take.tracks]),
        ("angle", angle, observable_angles(take.joints)),
        ("camera", camera, [known.name for known in take.cameras]),
    ):
        if value is not None:
            yield from unlisted_value(name, value, values)
    if angle is not None and camera is not None:
        yield Problem(VALUE_NOT_ALLOWED, "angle and camera can't be drawn together.", field="angle", hint="Omit one.")
    if frame is not None and frame not in range(take.timebase.num_frames):
        message = f"frame must be a whole number from 0 to {take.timebase.num_frames - 1}, not {frame!r:.80}."
        yield Problem(VALUE_NOT_ALLOWED, message, field="frame")


def _color(number: int) -> str:
    return _COLORS[number % len(_COLORS)]


def _middle_frame(take: Reconstruction, shown: Sequence[int]) -> int:
    """Middle frame of the person who is there longest; 0 without people."""
    frames = max((take.tracks[number].frames for number in shown), key=len, default=range(1))
    return frames[len(frames) // 2]


def _poses(take: Reconstruction, shown: Iterable[int], frame: int) -> list[tuple[int, Float[np.ndarray, "joints 3"]]]:
    """Places among the tracks, and joints in metres, of the people of a frame."""
    tracks = [(k, take.tracks[k]) for k in shown]
    return [(k, track.xyz_m[frame - track.start_frame]) for k, track in tracks if frame in track.frames]


def _lines(points: Float[np.ndarray, "joints axes"], joints: JointSet) -> Float[np.ndarray, "points axes"]:
    """Points of one line along all known bones, with NaN between them."""
    ends = points[[joints.index(name) for bone in joints.bones for name in bone]].reshape(-1, 2, points.shape[1])
    broken = np.pad(ends, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    return broken.reshape(-1, points.shape[1])


def _draw_people(
    ax: "Axes", people: Sequence[tuple[int, Float[np.ndarray, "joints 3"]]], joints: JointSet, names: Sequence[str]
) -> None:
    for number, xyz_m in people:
        ax.plot(*_lines(xyz_m, joints).T, color=_color(number), marker=".", label=names[number])
    ax.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    ax.set_aspect("equal")


def _draw_view(
    ax: "Axes",
    take: Reconstruction,
    name: str,
    frame: int,
    people: Sequence[tuple[int, Float[np.ndarray, "joints 3"]]],
    names: Sequence[str],
) -> None:
    """Draw detected joints as crosses, and the projected skeletons as lines, in a camera's picture."""
    place = [camera.name for camera in take.cameras].index(name)
    camera = take.cameras[place]
    for number, xyz_m in people:
        ax.plot(*_lines(project(camera, xyz_m), take.joints).T, color=_color(number), label=names[number])
        seen_px = take.observations[number].points_px[frame - take.tracks[number].start_frame, place]
        ax.plot(*seen_px.T, color=_color(number), marker="x", linestyle="")
    width, height = camera.size_px
    ax.set(xlim=(0, width), ylim=(height, 0), xlabel=f"x in {name}, px", ylabel="y, px")
    ax.set_aspect("equal")


def html(take: Reconstruction) -> str:
    """Summary of a take for notebooks: a small table of people, and a picture of the middle frame."""
    heads = ("person", "frames", "known joints", "reprojection error, px", "uncertainty, mm")
    rows = [
        element("tr", (element("td", text) for text in (name, *_figures(track))))
        for name, track in zip(individuals(take)[:_MAX_ROWS], take.tracks, strict=False)
    ]
    if len(take.tracks) > _MAX_ROWS:
        rows.append(element("tr", element("td", f"and {len(take.tracks) - _MAX_ROWS} more", colspan=len(heads))))
    table = element("table", element("tr", (element("th", head) for head in heads)), rows)
    return element("div", element("p", repr(take).strip("<>")), table, _picture(take))


def _figures(track: Track3D) -> Iterator[str]:
    known = np.isfinite(track.xyz_m).all(-1)
    yield f"{track.frames.start} to {track.frames.stop - 1}"
    yield f"{100 * known.mean():.0f}%"
    for values, unit in ((track.error_px, 1.0), (track.uncertainty_m, 1000.0)):
        stated = np.empty(0) if values is None else values[np.isfinite(values)]
        yield f"{unit * np.median(stated):.1f}" if len(stated) else "unknown"


def _picture(take: Reconstruction) -> Markup:
    """Skeletons of the middle frame from the front, as SVG."""
    everyone = range(len(take.tracks))
    frame = _middle_frame(take, everyone)
    shown = [(k, _lines(xyz_m, take.joints)) for k, xyz_m in _poses(take, everyone, frame)]
    places = np.concatenate([np.empty((0, 2)), *(lines_m[:, ::2] for _, lines_m in shown)])
    if not np.isfinite(places).any():
        return Markup()
    low, high = np.nanmin(places, 0), np.nanmax(places, 0)
    scale = _PICTURE_PX / max(high[1] - low[1], 0.1)
    width = scale * (high[0] - low[0]) + 10
    paths = []
    for number, lines_m in shown:
        x, y = scale * (lines_m[:, 0] - low[0]) + 5, scale * (high[1] - lines_m[:, 2]) + 5
        bones = np.column_stack([x, y])[np.arange(len(x)) % 3 < 2].reshape(-1, 4)
        words = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in bones[np.isfinite(bones).all(1)].tolist())
        paths.append(element("path", d=words, fill="none", stroke=_color(number), stroke_width="2"))
    height = _PICTURE_PX + 10
    label = f"Skeletons in frame {frame}, seen along y"
    return element("svg", paths, viewBox=f"0 0 {width:.0f} {height}", height=height, role="img", aria_label=label)
