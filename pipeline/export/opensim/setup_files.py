"""Files that OpenSim's tools read: markers over time, markers of the model, setups of scaling and inverse kinematics.

All of them lie in one folder, and name each other without a path.
"""

from collections.abc import Iterator, Mapping, Sequence
from xml.sax.saxutils import escape

import numpy as np

from pipeline.core.data.cameras import Timebase
from pipeline.export.opensim.anatomy import MARKERS
from pipeline.export.opensim.markers import MarkerPaths
from pipeline.export.opensim.scaling import ModelSize
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.writers.blocks import fixed, frame_blocks
from pipeline.export.writers.trc import head

GENERIC_MODEL, SCALED_MODEL = "generic.osim", "scaled.osim"
MARKER_SET, MARKER_PATHS = "markers.xml", "markers.trc"
SCALE_SETUP, IK_SETUP, MOTION = "scale.xml", "ik.xml", "ik.mot"

_MM_PER_M = 1000.0
_DECIMALS = 6
# Significant digits of the inverse kinematics, OpenSim's default.
_ACCURACY = "1e-05"


def encode_paths(paths: MarkerPaths, timebase: Timebase) -> Iterator[bytes]:
    """Write the paths of markers as TRC, piece by piece; metres, Y up, ``nan`` where a marker is unknown."""
    yield head(MARKER_PATHS, paths.names, timebase.frame_rate_hz, len(paths.frames))
    for rows in frame_blocks(len(paths.frames)):
        cells = fixed((paths.xyz_m[rows] @ Y_UP_FROM_WORLD.T).reshape(-1, 3 * len(paths.names)), 5, "\t")
        lines = (
            f"{frame + 1}\t{timebase.time_s(frame):.6f}\t{row}\n"
            for frame, row in zip(paths.frames[rows].tolist(), cells, strict=True)
        )
        yield "".join(lines).encode("ascii")


def encode_marker_set(names: Sequence[str], size: ModelSize) -> bytes:
    """Write the markers of the model, at their places in its bodies before these are scaled."""
    markers = "".join(
        f'<Marker name="{escape(name)}">'
        f"<socket_parent_frame>/bodyset/{MARKERS[name].body}</socket_parent_frame>"
        f"<location>{_numbers(size.places_m[name])}</location><fixed>true</fixed></Marker>\n"
        for name in names
    )
    return _document(f'<MarkerSet name="markers"><objects>\n{markers}</objects></MarkerSet>')


def encode_scale_setup(name: str, size: ModelSize) -> bytes:
    """Write the setup of the scale tool: factors of the bodies, and the mass."""
    scales = "".join(
        f"<Scale><scales>{_numbers(factors)}</scales><segment>{body}</segment><apply>true</apply></Scale>\n"
        for body, factors in size.factors.items()
    )
    return _document(
        f'<ScaleTool name="{name}">\n'
        f"<mass>{size.mass_kg:.3f}</mass><height>{size.stature_m * _MM_PER_M:.1f}</height>\n"
        f"<GenericModelMaker><model_file>{GENERIC_MODEL}</model_file>"
        f"<marker_set_file>{MARKER_SET}</marker_set_file></GenericModelMaker>\n"
        "<ModelScaler><apply>true</apply><scaling_order>manualScale</scaling_order>\n"
        f"<ScaleSet><objects>\n{scales}</objects></ScaleSet>\n"
        "<preserve_mass_distribution>true</preserve_mass_distribution>"
        f"<output_model_file>{SCALED_MODEL}</output_model_file></ModelScaler>\n"
        "<MarkerPlacer><apply>false</apply></MarkerPlacer>\n"
        "</ScaleTool>"
    )


def encode_ik_setup(name: str, paths: MarkerPaths, timebase: Timebase) -> bytes:
    """Write the setup of the inverse kinematics: which markers count how much."""
    tasks = "".join(
        f'<IKMarkerTask name="{escape(marker)}"><apply>true</apply>'
        f"<weight>{MARKERS[marker].weight:g}</weight></IKMarkerTask>\n"
        for marker in paths.names
    )
    first_s, last_s = (timebase.time_s(int(paths.frames[row])) for row in (0, -1))
    return _document(
        f'<InverseKinematicsTool name="{name}">\n'
        f"<results_directory>./</results_directory><model_file>{SCALED_MODEL}</model_file>\n"
        f"<constraint_weight>Inf</constraint_weight><accuracy>{_ACCURACY}</accuracy>\n"
        f"<time_range>{first_s:.6f} {last_s:.6f}</time_range>\n"
        f"<output_motion_file>{MOTION}</output_motion_file><report_errors>true</report_errors>\n"
        f"<marker_file>{MARKER_PATHS}</marker_file><coordinate_file></coordinate_file>\n"
        "<report_marker_locations>false</report_marker_locations>\n"
        f"<IKTaskSet><objects>\n{tasks}</objects></IKTaskSet>\n"
        "</InverseKinematicsTool>"
    )


def marker_errors_file(name: str) -> str:
    """Name of the file with the errors of markers that the inverse kinematics of a name writes."""
    return f"{name}_ik_marker_errors.sto"


def columns_of(content: str) -> Mapping[str, np.ndarray]:
    """Columns of a table that OpenSim has written, by name; empty if it is not whole."""
    names, *rows = content.partition("endheader")[2].strip().splitlines() or [""]
    cells = [row.split() for row in rows]
    width = len(names.split())
    if not cells or any(len(row) != width for row in cells):
        return {}
    return dict(zip(names.split(), np.array(cells, float).T, strict=True))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.{_DECIMALS}f}" for value in values)


def _document(content: str) -> bytes:
    return (
        f'<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40500">\n{content}\n</OpenSimDocument>\n'
    ).encode()
