"""Each format that is written serves the program whose format it is; `make verify-exports` runs it."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.program_files import PROGRAM_FORMATS
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

PEERS = Path(__file__).parents[3] / ".venv-peers"
TRIANGULATE = Path(__file__).parent / "programs" / "triangulate.py"
LENSES = {
    "none": (),
    "four": (-0.08, 0.03, 0.001, -0.002),
    "five": (-0.08, 0.03, 0.001, -0.002, 0.004),
    "eight": (0.3, 0.1, 0.001, -0.002, 0.01, 0.35, 0.12, 0.02),
    "fisheye": (0.03, -0.01, 0.002, -0.0004),
}


def rig_of_12(lens: str) -> tuple[Camera, ...]:
    """Ring of cameras whose lenses differ; some names are numbers, like Qualisys's and Panoptic's."""
    rig = build_cameras(Rig(Layout.RING, 12, (4.0, 3.5), 2.1), np.random.default_rng(68))
    return tuple(
        replace(
            camera,
            name=f"{number:02}" if number % 3 else f"cam_{number}",
            distortion=np.array(LENSES[lens]) * (1 + 0.1 * number),
            lens="fisheye" if lens == "fisheye" else "standard",
        )
        for number, camera in enumerate(rig)
    )


@pytest.mark.slow
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("name", ["anipose", "caliscope", "colmap", "freemocap", "opencv"])
def test_program_triangulates_with_cameras_that_are_written(tmp_path: Path, name: str, lens: str) -> None:
    if not (PEERS / ".installed").is_file():
        pytest.skip("aniposelib, Caliscope and COLMAP are not installed (`make verify-exports` does it)")
    rig = rig_of_12(lens)
    points_m = np.random.default_rng(7).uniform((-1.0, -1.0, 0.2), (1.0, 1.0, 1.8), (20, 3))
    (ending, *_), encode = PROGRAM_FORMATS[name].endings, PROGRAM_FORMATS[name].encode
    calibration, pixels, out = tmp_path / f"rig{ending}", tmp_path / "pixels.json", tmp_path / "out.json"
    calibration.write_bytes(encode(rig))
    pixels.write_text(json.dumps([project(camera, points_m).tolist() for camera in rig]))
    program = [str(PEERS / "bin" / "python"), str(TRIANGULATE), name, str(calibration), str(pixels), str(out)]
    finished = subprocess.run(program, check=False, timeout=300, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    found = json.loads(out.read_text())
    # Caliscope ignores names.
    assert found["names"] == [str(k) if name == "caliscope" else camera.name for k, camera in enumerate(rig)]
    # Caliscope computes with 24 bits, and OpenCV inverts lenses by iteration: a hundredth of a pixel at 5 m.
    np.testing.assert_allclose(found["points_m"], points_m, atol=1e-4)
