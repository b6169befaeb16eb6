"""Formats of result files, each declared once: name, label, media type and content. The web API imports this module."""

from typing import Annotated, Literal

from pipeline.core.options.choices import FileFormat, OptionalFile, OptionalPackage

OPENSIM_MODEL = OptionalFile(
    "the generic model of OpenSim", path="opensim/generic.osim", install="multicap opensim install"
)
"""Model that is scaled to people."""

_TEXT = "text/plain; charset=utf-8"
_CSV = "text/csv; charset=utf-8; header=present"
_BYTES = "application/octet-stream"

Export = (
    Annotated[Literal["bvh"], FileFormat("BVH, animation", _TEXT, "motion", has_presets=True)]
    | Annotated[Literal["glb"], FileFormat("GLB, body and animation", "model/gltf-binary", "motion", has_body=True)]
    | Annotated[
        Literal["fbx"], FileFormat("FBX, body and animation", _BYTES, "motion", has_body=True, has_presets=True)
    ]
    | Annotated[
        Literal["usd"],
        FileFormat(
            "USD, body and animation",
            _BYTES,
            "motion",
            has_body=True,
            ending="usdc",
            package=OptionalPackage("usd-core", module="pxr", extra="usd"),
        ),
    ]
    | Annotated[Literal["vrma"], FileFormat("VRMA, animation for VRM characters", "model/gltf-binary", "motion")]
    | Annotated[Literal["trc"], FileFormat("TRC, joints for OpenSim", _TEXT, "joints")]
    # The header counts frames in 16 bits, and readers take no longer files.
    | Annotated[Literal["c3d"], FileFormat("C3D, joints and segments", _BYTES, "joints")]
    | Annotated[Literal["csv"], FileFormat("CSV, joints in a table", _CSV, "joints")]
    | Annotated[Literal["angles"], FileFormat("CSV, joint angles in a table", _CSV, "angles", ending="angles.csv")]
    | Annotated[Literal["mot"], FileFormat("MOT, joint angles for OpenSim", _TEXT, "angles")]
    | Annotated[
        Literal["osim"],
        FileFormat(
            "OpenSim, scaled model and its motion",
            "application/zip",
            "model",
            ending="osim.zip",
            package=OptionalPackage("opensim", module="opensim", extra="opensim"),
            file=OPENSIM_MODEL,
        ),
    ]
    | Annotated[
        Literal["rerun"],
        FileFormat(
            "Rerun recording of the take",
            _BYTES,
            "recording",
            ending="rrd",
            package=OptionalPackage("rerun-sdk", module="rerun", extra="rerun"),
        ),
    ]
)
"""Names of the formats."""
