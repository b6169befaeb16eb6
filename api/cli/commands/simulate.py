"""`multicap simulate`: write simulated people as keypoint files with their exact truth."""

from pathlib import Path
from typing import Annotated

import typer

from api.cli.console import JsonOption, console, emit, reporting, shows_help, writing
from api.cli.options import SceneOption

if not shows_help():
    from pipeline.validation.simulation.scenes import known_joints, simulate, simulation_files


def command(
    scene: SceneOption,
    out: Annotated[Path, typer.Option(help="Folder for the files; created if it is missing.")],
    seed: Annotated[int, typer.Option(help="Random seed; the same seed gives the same bytes.")] = 0,
    views: Annotated[int | None, typer.Option(help="Number of cameras of the scene. Default: all.")] = None,
    joints: Annotated[
        str, typer.Option(metavar="body|feet|whole", help="Joints: of the body, with feet, or with feet and hands.")
    ] = "body",
    as_json: JsonOption = False,
) -> None:
    """Write a simulated scene: keypoint folders, timestamps and calibration for `reconstruct`, and the truth."""
    with reporting(as_json):
        simulation = simulate(scene, seed, views, known_joints(joints))
        with writing(out):
            for name, content in simulation_files(simulation):
                path = out / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
    if as_json:
        emit({"path": str(out)})
        return
    console.print(f"{len(simulation.cameras)} cameras, {len(simulation.truth_m)} people in {out}/.")
    console.print(
        f"multicap reconstruct --keypoints {out / 'keypoints'} --calibration {out / 'calibration.json'} "
        f"--timestamps {out / 'timestamps.csv'} --out RESULTS",
        soft_wrap=True,
    )
