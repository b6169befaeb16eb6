"""`multicap bodies`: the human body of exports, and the fit of a body model that the user supplies."""

from pathlib import Path
from typing import Annotated

import typer

from api.cli.console import JsonOption, console, emit, reporting, shows_help
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.request_codes import INVALID_VALUE

if not shows_help():
    import numpy as np

    from pipeline.core.runtime.npz import encode_arrays, read_untrusted_arrays
    from pipeline.export.writers.body_npz import LANDMARKS
    from pipeline.motion.body import installed
    from pipeline.motion.body.smplx_joints import SMPLX_JOINTS
    from pipeline.motion.body.smplx_model import FITTED, MOST_BYTES, fit_body, read_model

app = typer.Typer(help="The human body of exports, and body models of your own.", no_args_is_help=True)
_KEPT = ("gender", "surface_model_type", "mocap_frame_rate", "frame", "is_present", "pose_names")
_USED = ("poses", "joint_names", "joints_m", "landmark_names", "landmarks_m")


@app.command()
def install(as_json: JsonOption = False) -> None:
    """Download the human body and check it."""
    with reporting(as_json):
        path = installed.install()
    if as_json:
        emit({"path": str(path), "licence": installed.LICENCE})
        return
    console.print(f"The human body is in {path}")
    console.print(installed.ATTRIBUTION)


@app.command()
def fit(
    files: Annotated[list[Path], typer.Argument(help="Files of `--exports npz`, one a person.")],
    *,
    body_model: Annotated[Path, typer.Option(help="NPZ of SMPL-X from its makers, whose licence holds.")],
    as_json: JsonOption = False,
) -> None:
    """Fit shape and pose of a SMPL-X model to people; write PERSON.smplx.npz beside each file."""
    written: list[dict[str, object]] = []
    with reporting(as_json):
        written.extend(_fit(path, body_model) for path in files)
    if as_json:
        emit({"files": written})
        return
    for each in written:
        typer.echo(f"  {each['file']}  {each['error_mm']} mm from joints and points on the skin")


def _fit(path: Path, body_model: Path) -> dict[str, object]:
    """Fit a model to a person, and write the file; its path, and the median distance."""
    reason = "its joints, poses or landmarks are others"
    try:
        arrays = read_untrusted_arrays(path, (*_KEPT, *_USED), MOST_BYTES)
        names, marks, num_frames = (
            arrays["joint_names"].tolist(),
            arrays["landmark_names"].tolist(),
            len(arrays["frame"]),
        )
        lengths = {"poses": (3 * len(SMPLX_JOINTS),), "joints_m": (len(names), 3), "landmarks_m": (len(marks), 3)}
        is_whole = num_frames > 0 and {*FITTED} <= {*names} and {*marks} <= {*LANDMARKS}
        for name, shape in lengths.items():
            is_whole &= arrays[name].shape == (num_frames, *shape) and arrays[name].dtype.kind == "f"
        is_whole = is_whole and all(np.isfinite(arrays[name]).all() for name in ("poses", "joints_m"))
    except ValueError as error:
        is_whole, reason = False, str(error)
    except TypeError:
        is_whole = False
    if not is_whole:
        message = f"The file is no NPZ of a person: {reason}."
        raise InputError([Problem(INVALID_VALUE, message, file=path.name, hint="Make it by --exports npz.")])
    joints_m, poses = arrays["joints_m"], arrays["poses"].reshape(num_frames, -1, 3)
    places_m = {name: joints_m[:, k] for k, name in enumerate(names)}
    found = fit_body(read_model(body_model, tuple(marks)), places_m, arrays["landmarks_m"], poses)
    out = path.with_name(f"{path.stem}.smplx.npz")
    fitted = {"poses": found.poses.reshape(len(poses), -1), "trans": found.trans_m, "betas": found.betas}
    out.write_bytes(encode_arrays(fitted | {name: arrays[name] for name in _KEPT} | {"error_m": found.error_m}))
    return {"file": str(out), "error_mm": round(1000 * float(np.nanmedian(found.error_m)), 1)}
