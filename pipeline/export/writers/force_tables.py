"""Forces in tables: CSV for spreadsheets, and the external loads of OpenSim's inverse dynamics.

A CSV file has the columns ``frame``, ``time_s``, the force on the body, forces, centres of pressure and free moments of
the feet, moments of joints with the sign of the joint angles, and powers, with standard deviations (``sigma``). Units
are N, N m and W. If the mass was not stated, these follow from an estimate of it, and the same columns for each
kilogram are behind them. Cells of unknown values are empty.

External loads are a MOT file of forces, points and torques along OpenSim's axes (Y up), and an XML file that applies
them to the feet. OpenSim stops without a word at a number that is unknown, and continues forces before and after the
file in straight lines: numbers are 0 without contact, and the file has all frames of the take.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import SIDES
from pipeline.export.timelines import fixed, frame_blocks, unknown_outside
from pipeline.export.writers.angle_tables import read_csv
from pipeline.export.writers.registry import Expected, PersonContent, Writer
from pipeline.motion.angles.compute import NUM_POINTS, normalised_cycles
from pipeline.motion.forces.body_mass import BodyMass
from pipeline.motion.forces.joint_moments import MOMENT_NAMES, POWER_NAMES
from pipeline.motion.forces.person_forces import PersonForces
from pipeline.motion.gait.strides import Stride

_DECIMALS = 4
_AXES = "xyz"
# World axes of OpenSim's X, Y and Z, and their signs, as in TRC files.
_OPENSIM, _SIGNS = [0, 2, 1], np.array([1.0, 1.0, -1.0])
_BODIES = {"left": "calcn_l", "right": "calcn_r"}


def columns_of(forces: PersonForces) -> dict[str, Float[np.ndarray, " frames"]]:
    """Columns of a CSV file behind frame and time."""
    feet, mass = forces.feet, forces.mass
    columns = {"mass_kg": mass.kg, "mass_sigma_kg": mass.sigma_kg, "mass_is_estimated": float(mass.is_estimated)}
    of_frames = {name: np.full(len(forces.total), value) for name, value in columns.items()}
    of_frames |= _loads(forces.in_newtons(), "")
    for number, side in enumerate(SIDES):
        of_frames |= {f"{side}_pressure_{axis}_m": feet.pressure_m[:, number, k] for k, axis in enumerate(_AXES)}
        of_frames[f"{side}_pressure_sigma_m"] = feet.pressure_sigma_m[:, number]
        of_frames[f"{side}_is_measured"] = feet.measured[:, number].astype(float)
    flags = {"is_flight": forces.flies, "may_touch_person": forces.touches}
    flags |= {"is_seated": feet.seated, "is_undetermined": feet.undetermined}
    of_frames |= {name: flag.astype(float) for name, flag in flags.items()}
    return of_frames | (_loads(forces, "_kg") if mass.is_estimated else {})


def _loads(forces: PersonForces, unit: str) -> dict[str, Float[np.ndarray, " frames"]]:
    """Columns of forces, moments and powers, and their deviations."""
    force, moment, power = f"n{unit}", f"nm{unit}", f"w{unit}"
    feet, joints = forces.feet, forces.joints
    values = [("", forces.total, forces.total_sigma)]
    values += [(f"{side}_", feet.force[:, k], feet.sigma[:, k]) for k, side in enumerate(SIDES)]
    columns: dict[str, Float[np.ndarray, " frames"]] = {}
    for name, of_force, sigma in values:
        columns |= {f"{name}force_{axis}_{force}": of_force[:, k] for k, axis in enumerate(_AXES)}
        columns |= {f"{name}force_{axis}_sigma_{force}": sigma[:, k] for k, axis in enumerate(_AXES)}
    columns |= {f"{side}_free_moment_{moment}": feet.free_moment[:, k] for k, side in enumerate(SIDES)}
    columns |= {f"{name}_{moment}": joints.moment[:, k] for k, name in enumerate(MOMENT_NAMES)}
    columns |= {f"{name}_sigma_{moment}": joints.sigma[:, k] for k, name in enumerate(MOMENT_NAMES)}
    return columns | {f"{name}_{power}": joints.power[:, k] for k, name in enumerate(POWER_NAMES)}


def _encode(person: PersonContent) -> Iterator[bytes]:
    forces, timebase, frames = person.forces(), person.timebase, person.frames
    columns = {} if forces is None else columns_of(forces)
    yield (",".join(["frame", "time_s", *columns]) + "\r\n").encode("ascii")
    if forces is None:
        return
    values = np.stack(list(columns.values()), axis=1)
    for rows in frame_blocks(len(frames)):
        cells = fixed(unknown_outside(values, forces.frames, frames[rows]), _DECIMALS, ",")
        numbers = zip(frames[rows], cells, strict=True)
        lines = (f"{number},{timebase.time_s(number):.6f},{row}\r\n" for number, row in numbers)
        yield "".join(lines).replace("nan", "").encode("ascii")


def _expected(person: PersonContent) -> Expected:
    forces = person.forces()
    if forces is None:
        return lambda frames: np.empty((len(frames), 0, 1))
    values = np.stack(list(columns_of(forces).values()), axis=1)[..., None]
    return partial(unknown_outside, values, forces.frames)


def _frames(person: PersonContent) -> range:
    """Frames of a file: none without forces."""
    return person.frames if person.forces() is not None else person.frames[:0]


CSV = Writer(_encode, lambda path, _: read_csv(path), _expected, frames=_frames)


def cycle_table(forces: PersonForces, strides: Sequence[Stride]) -> bytes | None:
    """CSV file of forces over steady strides, for each kilogram: mean and standard deviation at 0 to 100 % of a stride.

    Strides go from a foot strike to the next one of the same foot. ``None`` without steady strides.
    """
    columns: dict[str, Float[np.ndarray, " points"]] = {}
    for number, side in enumerate(SIDES):
        lines = {f"{side}_force_z_n_kg": forces.feet.force[:, number, 2]}
        moments, powers = ((name, k) for k, name in enumerate(MOMENT_NAMES)), enumerate(POWER_NAMES)
        lines |= {f"{name}_nm_kg": forces.joints.moment[:, k] for name, k in moments if name.startswith(side)}
        lines |= {f"{name}_w_kg": forces.joints.power[:, k] for k, name in powers if name.startswith(side)}
        steady = [stride for stride in strides if stride.side == side and stride.is_steady]
        spans = [(stride.strike_row, stride.next_row) for stride in steady]
        for name, line in lines.items():
            cycles = normalised_cycles(line, spans)
            if len(cycles):
                std = cycles.std(0, ddof=1) if len(cycles) > 1 else np.full(NUM_POINTS, np.nan)
                num = np.full(NUM_POINTS, float(len(cycles)))
                columns |= {f"{name}_mean": cycles.mean(0), f"{name}_std": std, f"{name}_strides": num}
    if not columns:
        return None
    cells = fixed(np.stack(list(columns.values()), axis=1), _DECIMALS, ",")
    lines_of_file = [",".join(["percent", *columns]), *(f"{percent},{row}" for percent, row in enumerate(cells))]
    return "".join(f"{line}\r\n" for line in lines_of_file).replace("nan", "").encode("ascii")


def external_loads(forces: PersonForces, timebase: Timebase, frames: range, file_name: str) -> Iterator[bytes]:
    """MOT file with the external loads of a person's feet on OpenSim's axes, piece by piece."""
    feet = forces.in_newtons().feet
    torque = np.zeros_like(feet.force)
    torque[..., 2] = feet.free_moment
    parts = [
        np.where(feet.stands[..., None], np.nan_to_num(part), 0.0) for part in (feet.force, feet.pressure_m, torque)
    ]
    names = [
        f"{side}_ground_{name}{axis}" for side in SIDES for name in ("force_v", "force_p", "torque_") for axis in _AXES
    ]
    values = np.concatenate([part[:, side][:, _OPENSIM] * _SIGNS for side in range(2) for part in parts], axis=1)
    head = [file_name, "version=1", f"nRows={len(frames)}", f"nColumns={1 + len(names)}", "inDegrees=yes", "endheader"]
    yield "".join(f"{line}\n" for line in [*head, "\t".join(["time", *names])]).encode("utf-8")
    for rows in frame_blocks(len(frames)):
        cells = fixed(np.nan_to_num(unknown_outside(values, forces.frames, frames[rows])), _DECIMALS, "\t")
        numbers = zip(frames[rows], cells, strict=True)
        yield "".join(f"{timebase.time_s(number):.6f}\t{row}\n" for number, row in numbers).encode("ascii")


def external_loads_setup(file_name: str, mass: BodyMass) -> bytes:
    """XML file that applies the forces of a MOT file to the feet of OpenSim's models."""
    loads = "".join(
        f"""      <ExternalForce name="{side}">
        <isDisabled>false</isDisabled>
        <applied_to_body>{_BODIES[side]}</applied_to_body>
        <force_expressed_in_body>ground</force_expressed_in_body>
        <point_expressed_in_body>ground</point_expressed_in_body>
        <force_identifier>{side}_ground_force_v</force_identifier>
        <point_identifier>{side}_ground_force_p</point_identifier>
        <torque_identifier>{side}_ground_torque_</torque_identifier>
      </ExternalForce>
"""
        for side in SIDES
    )
    text = f"""<?xml version="1.0" encoding="UTF-8" ?>
<!-- {str(mass).capitalize()} -->
<OpenSimDocument Version="40000">
  <ExternalLoads name="forces">
    <objects>
{loads}    </objects>
    <groups />
    <datafile>{file_name}</datafile>
  </ExternalLoads>
</OpenSimDocument>
"""
    return text.encode("ascii")
