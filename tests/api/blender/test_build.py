"""The zip of the extension: same bytes, relative imports, a manifest that Blender takes, and Python that runs alone."""

import ast
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

from api.blender.build import SHARED, build
from api.blender.extension.capture_folder import VIDEO_ENDINGS
from pipeline.capture import video_files
from pipeline.core.joints import FINGERS as JOINTS_OF_FINGERS
from pipeline.export.character.bone_names import FINGERS

ROOT = Path(__file__).parents[3]
OF_BLENDER = {"bpy", "mathutils"}


def test_build_gives_same_bytes_each_time(tmp_path: Path) -> None:
    first, second = (build(tmp_path / name).read_bytes() for name in ("a", "b"))
    assert first == second


def test_modules_import_standard_library_and_blender_only(tmp_path: Path) -> None:
    with zipfile.ZipFile(build(tmp_path)) as archive:
        modules = {name: archive.read(name) for name in archive.namelist() if name.endswith(".py")}
    assert {Path(name).name for name in SHARED} < set(modules)
    for name, content in modules.items():
        for node in ast.walk(ast.parse(content)):
            match node:
                case ast.Import(names=aliases):
                    found = {alias.name.partition(".")[0] for alias in aliases}
                case ast.ImportFrom(module=str(module), level=0):
                    found = {module.partition(".")[0]}
                case ast.ImportFrom(module=str(module), level=1):
                    assert f"{module}.py" in modules, name
                    continue
                case _:
                    continue
            assert found <= set(sys.stdlib_module_names) | OF_BLENDER, name


def test_modules_without_blender_run_outside_of_project(tmp_path: Path) -> None:
    with zipfile.ZipFile(build(tmp_path)) as archive:
        archive.extractall(tmp_path / "somewhere" / "odd_name")
    program = (
        "from odd_name.client import BlenderClient; from odd_name import retarget, glb_motion, tasks, capture_folder\n"
        "from odd_name.bone_tree import BoneTree, recognise_bones\n"
        "print(recognise_bones(BoneTree(('Hips', 'mixamorig:LeftArm'), (-1, 0))))"
    )
    command = [sys.executable, "-S", "-E", "-c", program]
    done = subprocess.run(command, cwd=tmp_path / "somewhere", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "{'LeftArm': 'mixamorig:LeftArm'}\n"), done.stderr


def test_manifest_fits_blender_and_project() -> None:
    manifest = tomllib.loads((ROOT / "api/blender/extension/blender_manifest.toml").read_text("utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert (manifest["schema_version"], manifest["id"], manifest["type"]) == ("1.0.0", "multicap", "add-on")
    release = project["version"].partition("rc")[0]  # Blender takes no release candidates
    assert (manifest["version"], manifest["license"]) == (release, [f"SPDX:{project['license']}"])
    assert tuple(map(int, manifest["blender_version_min"].split("."))) == (4, 2, 0)
    # Blender refuses longer texts, and those that end with a full stop.
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64
        assert not text.endswith(".")


def test_shared_constants_are_equal() -> None:
    assert tuple(JOINTS_OF_FINGERS) == FINGERS
    assert video_files._VIDEO_ENDINGS == VIDEO_ENDINGS
