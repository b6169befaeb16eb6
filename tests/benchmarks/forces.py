"""Benchmark `forces`: estimated forces beside force plates of public trials of OpenSim, and OpenSim's inverse dynamics.

The folder has files of github.com/opensim-org/opensim-models and, in folders of their names, OpenCap's people of
github.com/keenon/nimblephysics (docs/lab/forces-notes.md has their places and digests).
Forces are in % of body weight, moments in N m for each kilogram of the body.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from api.cli.console import print_table
from pipeline.capture.points import open_points
from pipeline.core.data.reconstruction import Reconstruction, Subject
from pipeline.core.joints import SIDES
from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.joint_moments import MOMENT_NAMES, JointMoments, joint_moments
from pipeline.motion.forces.person_forces import PersonForces, forces_of
from pipeline.motion.forces.whole_body import body_in_motion
from pipeline.run.engine.local import reconstruct

Names = tuple[str, str, str]


class Trial(NamedTuple):
    """Public trial: markers, static trial, plates with the columns of the left and the right foot, and mass."""

    markers: str
    static: str
    plates: str
    left: Names
    right: Names
    mass_kg: float | None  # ``None``: the mean force of the plates over the rows tells it
    rows: slice = slice(None)  # Frames in which every standing foot is on a plate
    moments: str | None = None  # OpenSim's inverse dynamics with the plates


_OLD = ("ground_force_v", "ground_force_p", "ground_torque_")
TRIALS = {
    "walk 2354": Trial(
        "subject01_walk1.trc",
        "subject01_static.trc",
        "subject01_walk1_grf.mot",
        ("1_ground_force_v", "1_ground_force_p", "1_ground_torque_"),
        _OLD,
        72.6,
        moments="subject01_walk_ID.sto",
    ),
    "walk Rajagopal": Trial(
        "motion_capture_walk.trc",
        "static_walk_1.trc",
        "grf_walk.mot",
        ("ground_force_l_v", "ground_force_l_p", "ground_torque_l_"),
        ("ground_force_r_v", "ground_force_r_p", "ground_torque_r_"),
        None,
        slice(45, 198),
    ),
    "run Rajagopal": Trial(
        "motion_capture_run.trc",
        "static_run.trc",
        "grf_run.mot",
        ("L_ground_force_v", "L_ground_force_p", "L_ground_torque_"),
        ("R_ground_force_v", "R_ground_force_p", "R_ground_torque_"),
        72.84,
    ),
    "run Hamner": Trial(
        "subject02_running.trc",
        "subject02_static.trc",
        "subject02_running_grf.mot",
        ("1_ground_force_v", "1_ground_force_p", "1_ground_torque_"),
        _OLD,
        65.9,
    ),
}
# People of OpenCap's data, whose trials are in a folder of their name: mass by the plates in kg.
OPENCAP = {"Subject4": 60.05, "OpenCapUnfiltered": 95.0}
# Frames around the double supports of a walk in which all standing feet are on plates.
_AROUND = 20
# Least share of body weight of a loaded plate.
_LOADED = 0.05
# OpenSim's X, Y up and Z in our world, and its coordinates of the moments with their signs.
_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_MOMENTS = {
    "hip_flexion": ("hip_flexion_", 1.0),
    "knee_flexion": ("knee_angle_", -1.0),
    "ankle_dorsiflexion": ("ankle_angle_", 1.0),
}


def read_table(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and numbers of a MOT or STO file."""
    lines = path.read_text().splitlines()
    first = [line.strip() for line in lines].index("endheader") + 1
    return lines[first].split(), np.array([line.split() for line in lines[first + 1 :] if line.strip()], float)


def columns(path: Path, prefix: str, time_s: np.ndarray) -> np.ndarray:
    """Mean vectors of three columns over frames, in our world."""
    names, values = read_table(path)
    step_s = time_s[1] - time_s[0]
    around = [time_s + share * step_s for share in np.linspace(-0.45, 0.45, 7)]
    own_s, columns = values[:, 0], [values[:, names.index(f"{prefix}{axis}")] for axis in "xyz"]
    return np.mean([[np.interp(at, own_s, column) for column in columns] for at in around], axis=0).T @ _WORLD.T


def measure(folder: Path, trial: Trial) -> tuple[list[str], list[list[str]]]:
    """Rows of the tables of forces and of moments."""
    take: Reconstruction = reconstruct(open_points([folder / trial.markers], static=folder / trial.static))
    track, motion = take.tracks[0], take.motions[0]
    time_s = take.timebase.start_time_s + np.array(track.frames) / take.timebase.frame_rate_hz
    truth = np.stack([columns(folder / trial.plates, names[0], time_s) for names in (trial.left, trial.right)], axis=1)
    mass_kg = trial.mass_kg or float(truth[48:144].sum(1)[:, 2].mean() / GRAVITY_M_S2)
    truth = truth / mass_kg
    found = forces_of(motion, track, take.joints, Subject(sex="male", mass_kg=mass_kg), take.animation.floor)
    assert found is not None
    percent = 100.0 / found.weight
    error = (found.total - truth.sum(1)) * percent
    of_feet = (found.feet.force - truth) * percent
    cover = np.abs(error) < 1.96 * found.total_sigma * percent

    def size(values: np.ndarray) -> str:
        return " ".join(f"{value:.1f}" for value in np.sqrt((values[trial.rows] ** 2).mean(0)))

    row = [size(error), *(size(of_feet[:, side]) for side in range(2))]
    row += [" ".join(f"{100 * value:.0f}" for value in cover[trial.rows].mean(0)), f"{found.flight_residual:.2f}"]
    plates_m, torque = (
        np.stack([columns(folder / trial.plates, names[kind], time_s) for names in (trial.left, trial.right)], axis=1)
        for kind in (1, 2)
    )
    loaded = truth[..., 2] > _LOADED * GRAVITY_M_S2
    plates = replace(
        found.feet,
        stands=loaded,
        force=truth * loaded[..., None],
        pressure_m=np.where(loaded[..., None], plates_m, np.nan),
        free_moment=np.where(loaded, torque[..., 2] / mass_kg, 0.0),
    )
    subject = Subject(sex="male", mass_kg=mass_kg)
    body = body_in_motion(motion, track, take.joints, subject, found.flies)
    assert body is not None
    of_moments = beside(found.joints, joint_moments(body, plates, take.joints), trial.rows)
    if trial.moments is not None:
        of_moments += moments(folder / trial.moments, found, time_s, mass_kg)
    return row, of_moments


def opencap(folder: Path, mass_kg: float) -> list[list[str]]:
    """Rows of one person's trials: force on the body, or of the feet on a seat, beside the sum of the plates."""
    static, lines = folder / "static1.trc", []
    for plates in sorted(folder.glob("*_grf.mot")):
        markers = folder / f"{plates.stem.removesuffix('_grf')}.trc"
        if markers == static:
            continue
        take = reconstruct(open_points([markers], static=static if static.is_file() else None))
        track = take.tracks[0]
        time_s = take.timebase.start_time_s + np.array(track.frames) / take.timebase.frame_rate_hz
        prefixes = [name[:-1] for name in read_table(plates)[0] if name.endswith("_vx")]
        truth = np.stack([columns(plates, prefix, time_s) for prefix in prefixes], axis=1) / mass_kg
        loaded = truth[..., 2] > _LOADED * GRAVITY_M_S2
        rows = np.zeros(len(truth), bool)
        if markers.stem.startswith("walk"):
            both = np.flatnonzero(loaded.sum(1) > 1)
            rows[max(both[0] - _AROUND, 0) : both[-1] + _AROUND] = True
        else:
            # A box under the feet before a drop jump has no plate.
            rows[loaded.any(1).argmax() :] = True
        found = forces_of(
            take.motions[0], track, take.joints, Subject("de-leva", "male", mass_kg), take.animation.floor
        )
        assert found is not None
        feet = found.feet
        force, sigma = found.total, found.total_sigma
        if feet.seated.any():
            force, sigma = feet.force.sum(1), np.sqrt((feet.sigma**2).sum(1))
        error, percent = force - truth.sum(1), 100.0 / GRAVITY_M_S2
        rows &= np.isfinite(error).all(1)
        if not rows.any():
            continue
        sizes = " ".join(f"{value:.1f}" for value in percent * np.sqrt((error[rows] ** 2).mean(0)))
        cover = " ".join(f"{value:.0f}" for value in 100 * (np.abs(error) < 1.96 * sigma)[rows].mean(0))
        flags = f"{feet.seated.sum()} {feet.undetermined.sum()}"
        lines.append([f"{folder.name} {markers.stem}", f"{rows.sum()}", sizes, cover, flags])
    return lines


def beside(own: JointMoments, plates: JointMoments, rows: slice) -> list[list[str]]:
    """Largest and smallest moments beside the same body's with the plates, and RMS of the differences."""
    lines = []
    for name in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        for side in SIDES:
            column = MOMENT_NAMES.index(f"{side}_{name}")
            ours, theirs = own.moment[rows, column], plates.moment[rows, column]
            ends = [f"{ours.max():.2f} ({theirs.max():.2f})", f"{ours.min():.2f} ({theirs.min():.2f})"]
            lines.append([f"{side} {name}, plates", *ends, f"{np.sqrt(((ours - theirs) ** 2).mean()):.2f}"])
    return lines


def moments(path: Path, own: PersonForces, time_s: np.ndarray, mass_kg: float) -> list[list[str]]:
    """Largest and smallest moments beside OpenSim's, and the root mean square of the differences."""
    names, values = read_table(path)
    rows = []
    for name, (coordinate, sign) in _MOMENTS.items():
        for side in SIDES:
            theirs = np.interp(time_s, values[:, 0], values[:, names.index(f"{coordinate}{side[0]}_moment")])
            theirs = sign * theirs / mass_kg
            ours = own.joints.moment[:, MOMENT_NAMES.index(f"{side}_{name}")]
            apart = np.sqrt(((ours - theirs) ** 2).mean())
            ends = [f"{ours.max():.2f} ({theirs.max():.2f})", f"{ours.min():.2f} ({theirs.min():.2f})"]
            rows.append([f"{side} {name}", *ends, f"{apart:.2f}"])
    return rows


def forces(folder: Annotated[Path, typer.Argument(help="Folder with the files of the trials.")]) -> None:
    """Print the errors of all trials whose files are there."""
    found, tables, of_people = [], [], []
    for name, trial in TRIALS.items():
        if (folder / trial.markers).is_file():
            row, of_moments = measure(folder, trial)
            found.append([name, *row])
            tables += of_moments
    for name, mass_kg in OPENCAP.items():
        of_people += opencap(folder / name, mass_kg)
    print_table(("trial", "body x y z", "left", "right", "within 2 sd, %", "flight"), found)
    print_table(("moment", "largest (plates or OpenSim)", "smallest", "RMS"), tables)
    print_table(("trial of OpenCap", "frames", "x y z", "within 2 sd, %", "seated, undetermined"), of_people)
