"""The extension in Blender, installed from its zip, with a service that runs."""

import json
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.blender.build import build
from api.settings import Settings
from pipeline.data.reconstruction import Reconstruction
from pipeline.export.results import write_results
from pipeline.skeleton.model import INDEX, SKELETON
from tests.api.conftest import Live, running
from tests.e2e.foreign import BLENDER
from tests.pipeline.export.test_scene import GLB, NAMES, named
from tests.pipeline.export.test_timelines import NUM_FRAMES, RATE_HZ, nearest_m, two_people
from worker.jobs.model.rights import Scope

__all__ = ["named", "two_people"]
pytestmark = pytest.mark.blender
Steps = Sequence[tuple[str, dict[str, Any]]]


@pytest.fixture(scope="session")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("extension"))


@pytest.fixture
def blender(extension: Path, tmp_path: Path) -> Callable[..., list[Any]]:
    """Run steps in Blender; return what they found."""

    def run(address: str, steps: Steps, key: str = "") -> list[Any]:
        if not BLENDER.is_file():
            pytest.skip("Blender is not installed (`make verify-exports` does it)")
        job, out = tmp_path / "job.json", tmp_path / "out.json"
        job.write_text(
            json.dumps({"zip": str(extension), "address": address, "key": key, "steps": steps, "out": str(out)})
        )
        command = [BLENDER, Path(__file__).with_name("program.py"), job]
        environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "blender")}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "Traceback" not in done.stdout + done.stderr, done.stderr
        found: list[Any] = json.loads(out.read_text())
        return found

    return run


@pytest.fixture(scope="module")
def files(named: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """GLB files of a take."""
    paths = write_results(named, tmp_path_factory.mktemp("files"), GLB)
    return {path.name: path.read_bytes() for path in paths if path.suffix == ".glb"}


def with_people(live: Live, named: Reconstruction, files: dict[str, bytes]) -> str:
    """Job of a take with files; its people have the names of the take."""
    job_id = live.job_id()
    live.finish(job_id, scenes=files, names={f"person-{motion.track_id}": motion.name for motion in named.motions})
    return job_id


def test_import(
    make_settings: Callable[..., Settings],
    named: Reconstruction,
    files: dict[str, bytes],
    blender: Callable[..., list[Any]],
) -> None:
    with running(make_settings()) as live:
        _, key = live.services.store.keys.add("studio", "blender", frozenset({Scope.READ, Scope.WRITE}))
        live.client.headers["Authorization"] = f"Bearer {key}"
        with_people(live, named, files)
        panel, imported, scene, left = blender(
            str(live.client.base_url),
            [
                ("show_people", {}),
                ("press", {"name": "import_people"}),
                ("scene", {}),
                ("unregister", {}),
            ],
            key,
        )
    assert panel["tenant"] == "studio"
    assert panel["people"] == list(NAMES)
    assert imported["message"] == "Imported 2 people."
    assert (scene["rate_hz"], scene["frames"]) == (pytest.approx(RATE_HZ), [0, NUM_FRAMES - 1])
    assert {name for name, kind in scene["objects"].items() if kind == "ARMATURE"} == set(NAMES)
    for name in NAMES:
        for joint in SKELETON:
            found_m = np.array(scene["heads"][name][joint.name])
            np.testing.assert_allclose(found_m, nearest_m(named)[name][:, INDEX[joint.name]], atol=1e-4)
    assert left == []
