"""Formats of result files, each declared once: name, label, media type, content and size.

The web API imports this module. A format of people's files has a writer in ``pipeline.export.writers``. Formats of
other packages are added by entry points.
"""

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Literal, cast

from pipeline.core.options.choices import FileFormat, FileSize, OptionalFile, OptionalPackage, named_values
from pipeline.core.runtime.packages.storage import home
from pipeline.core.runtime.plugins import load_plugins

WRITERS = "multicap.writers"
"""Group of the entry points of formats."""

OPENSIM_MODEL = OptionalFile(
    "the generic model of OpenSim", path="opensim/generic.osim", install="multicap opensim install"
)
"""Model that is scaled to people."""

_TEXT = "text/plain; charset=utf-8"
_CSV = "text/csv; charset=utf-8; header=present"
_BYTES = "application/octet-stream"

Export = (
    Annotated[
        Literal["bvh"],
        FileFormat("BVH, animation", _TEXT, "motion", ".bvh:WRITER", has_presets=True, size=FileSize(2_000, 475)),
    ]
    | Annotated[
        Literal["glb"],
        FileFormat(
            "GLB, body and animation",
            "model/gltf-binary",
            "motion",
            ".glb:WRITER",
            has_body=True,
            size=FileSize(108_000, 320),
            in_take=True,
        ),
    ]
    | Annotated[
        Literal["fbx"],
        FileFormat(
            "FBX, body and animation",
            _BYTES,
            "motion",
            ".fbx:WRITER",
            has_body=True,
            has_presets=True,
            size=FileSize(138_000, 505),
            in_take=True,
        ),
    ]
    | Annotated[
        Literal["usd"],
        FileFormat(
            "USD, body and animation",
            _BYTES,
            "motion",
            ".usd:WRITER",
            has_body=True,
            ending="usdc",
            package=OptionalPackage("usd-core", module="pxr", extra="usd"),
            size=FileSize(100_000, 350),
            in_take=True,
        ),
    ]
    | Annotated[
        Literal["vrma"],
        FileFormat(
            "VRMA, animation for VRM characters",
            "model/gltf-binary",
            "motion",
            ".vrma:WRITER",
            size=FileSize(4_000, 390),
        ),
    ]
    | Annotated[
        Literal["trc"],
        FileFormat("TRC, joints for OpenSim", _TEXT, "joints", ".trc:WRITER", size=FileSize(of_joint=24)),
    ]
    # The header counts frames in 16 bits, and readers take no longer files.
    | Annotated[
        Literal["c3d"],
        FileFormat("C3D, joints and segments", _BYTES, "joints", ".c3d_file:WRITER", size=FileSize(2_000, 1_350)),
    ]
    | Annotated[
        Literal["csv"],
        FileFormat("CSV, joints in a table", _CSV, "joints", ".csv_table:WRITER", size=FileSize(1_000, of_joint=22)),
    ]
    | Annotated[
        Literal["npz"],
        FileFormat(
            "NPZ, joints and rotations for SMPL-X and MHR",
            _BYTES,
            "motion",
            ".body_npz:WRITER",
            note="No data of these models is in it. Their makers' licences hold for the models.",
            size=FileSize(6_000, 2_000, 24),
        ),
    ]
    | Annotated[
        Literal["angles"],
        FileFormat(
            "CSV, joint angles in a table",
            _CSV,
            "angles",
            ".angle_tables:CSV",
            ending="angles.csv",
            size=FileSize(1_000, 480),
        ),
    ]
    | Annotated[
        Literal["mot"],
        FileFormat("MOT, joint angles for OpenSim", _TEXT, "angles", ".angle_tables:MOT", size=FileSize(1_000, 260)),
    ]
    | Annotated[
        Literal["forces"],
        FileFormat(
            "CSV, forces and joint moments",
            _CSV,
            "forces",
            ".force_tables:CSV",
            note="Files for OpenSim's inverse dynamics, too.",
            ending="forces.csv",
            size=FileSize(8_000, 1_300),
        ),
    ]
    | Annotated[
        Literal["osim"],
        FileFormat(
            "OpenSim, scaled model and its motion",
            "application/zip",
            "model",
            ending="osim.zip",
            package=OptionalPackage("opensim", module="opensim", extra="opensim"),
            file=OPENSIM_MODEL,
            size=FileSize(40_000, 480),
        ),
    ]
    | Annotated[
        Literal["rerun"],
        FileFormat(
            "Rerun, file of the take",
            _BYTES,
            "recording",
            ending="rrd",
            package=OptionalPackage("rerun-sdk", module="rerun", extra="rerun"),
        ),
    ]
)
"""Names of the formats."""

PLUGINS = load_plugins(WRITERS, FileFormat)
"""Formats of other packages by name."""

if not TYPE_CHECKING:
    for _name, _format in PLUGINS.items():
        Export |= Annotated[Literal[_name], _format]
FILE_FORMATS = cast(Mapping[Export, FileFormat], named_values(Export, FileFormat))
"""Formats of people's files by name."""


def file_ending(export: Export) -> str:
    """Ending of the names of a format's files, without the dot."""
    return FILE_FORMATS[export].ending or export


def formats_of_people(exports: Iterable[Export]) -> tuple[Export, ...]:
    """Formats of people's files that have a writer; stages of their own make the others."""
    return tuple(export for export in exports if FILE_FORMATS[export].writer is not None)


def is_installed(export: Export) -> bool:
    """True if the package and the file that a format needs are installed here, or it needs none."""
    package, file = FILE_FORMATS[export].package, FILE_FORMATS[export].file
    has_package = package is None or find_spec(package.module) is not None
    return has_package and (file is None or (home() / file.path).is_file())


def installed_formats() -> tuple[Export, ...]:
    """Formats whose files can be written here."""
    return tuple(filter(is_installed, FILE_FORMATS))
