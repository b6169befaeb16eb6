"""Fit of a body model with the arrays of SMPL-X, which the tests make: the real model is licensed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from api.cli.main import app
from multicap import InputError
from pipeline.core.runtime.npz import encode_arrays
from pipeline.export.writers.body_npz import LANDMARKS
from pipeline.motion.body.smplx_joints import JOINT_MAP, NUM_BODY, SMPLX_FROM_OURS, SMPLX_JOINTS
from pipeline.motion.body.smplx_model import FITTED, SmplxModel, fit_body, read_model
from pipeline.motion.skeleton.model import WHOLE_SKELETON
from tests.pipeline.capture.point_files.mutations import mutated

_OTHERS = {"spine2": "spine1", "left_foot": "left_ankle", "right_foot": "right_ankle"}


def synthetic() -> dict[str, np.ndarray]:
    """Arrays of a model: eight vertices around each joint, and one at each landmark."""
    random = np.random.default_rng(7)
    rest_m: dict[str, np.ndarray] = {}
    above: dict[str, str | None] = {}
    for joint in WHOLE_SKELETON:
        place = rest_m[joint.parent] if joint.parent else np.zeros(3)
        rest_m[joint.name] = place + 1.75 * joint.stature_share * SMPLX_FROM_OURS @ np.array(joint.rest_direction)
        above[joint.name] = joint.parent
    ours = {smplx: name for name, (smplx, _) in JOINT_MAP.items()}
    places, parents = [], []
    for name in SMPLX_JOINTS:
        if name in ours:
            places.append(rest_m[ours[name]])
            mapped = JOINT_MAP.get(above[ours[name]] or "", ("pelvis", ""))[0]
            parents.append(SMPLX_JOINTS.index({"spine1": "spine2"}.get(mapped, mapped) if name == "spine3" else mapped))
        else:
            near = _OTHERS.get(name, "head")
            places.append(rest_m[ours[near]] + [0.0, 0.03, 0.05])
            parents.append(SMPLX_JOINTS.index(near))
    joints_m, num = np.array(places), len(SMPLX_JOINTS)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * 0.02
    marks = {
        "nose": ("head", (0.0, 0.05, 0.15)),
        **{f"{side}_ear": ("head", (sign * 0.08, 0.04, 0.0)) for side, sign in (("left", 1), ("right", -1))},
        **{f"{side}_heel": (f"{side}_ankle", (0.0, -0.06, -0.09)) for side in ("left", "right")},
        **{
            f"{side}_big_toe": (f"{side}_foot", (-0.02 * sign, -0.06, 0.2))
            for side, sign in (("left", 1), ("right", -1))
        },
    }
    owners = [*np.repeat(np.arange(num), 8), *(SMPLX_JOINTS.index(joint) for joint, _ in marks.values())]
    template = (joints_m[:, None] + corners).reshape(-1, 3)
    template = np.concatenate(
        [template, [joints_m[SMPLX_JOINTS.index(joint)] + place for joint, place in marks.values()]]
    )
    shapes = 1e-4 * random.normal(size=(len(template), 3, 12))
    shapes[..., 0] += 0.05 * template  # the whole body
    shapes[:, 1, 1] += 0.06 * np.minimum(template[:, 1], 0.0)  # the legs
    regressor = np.zeros((num, len(template)))
    for row in range(num):
        regressor[row, 8 * row : 8 * row + 8] = 1 / 8
    return {
        "v_template": template,
        "shapedirs": shapes,
        "posedirs": 1e-4 * random.normal(size=(len(template), 3, 9 * (num - 1))),
        "J_regressor": regressor,
        "weights": np.eye(num)[owners],
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(num)], np.uint32),
        "f": np.zeros((1, 3), np.uint32),
    }


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "SMPLX_NEUTRAL.npz"
    # The public file has dictionaries too, which are pickles.
    arrays: dict[str, Any] = {**synthetic(), "part2num": np.array({"Pelvis": 0}, object)}
    np.savez(path, **arrays)
    return path


def skinned(arrays: dict[str, np.ndarray], betas: np.ndarray, turns: np.ndarray, trans_m: np.ndarray) -> Any:
    """Joints and all vertices in one pose, as the paper has it, vertex by vertex."""
    shaped = arrays["v_template"] + arrays["shapedirs"][..., : len(betas)] @ betas
    rest_m, num = arrays["J_regressor"] @ shaped, len(SMPLX_JOINTS)
    turns = np.concatenate([turns, np.tile(np.eye(3), (num - len(turns), 1, 1))])
    shaped = shaped + arrays["posedirs"] @ (turns[1:] - np.eye(3)).reshape(-1)
    world: list[np.ndarray] = []
    for joint, parent in enumerate(arrays["kintree_table"][0].astype(int)):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[joint], rest_m[joint] - (rest_m[parent] if joint else 0.0)
        world.append(world[parent] @ local if joint else local)
    owner = arrays["weights"].argmax(1)
    vertices = [
        world[k][:3, :3] @ (vertex - rest_m[k]) + world[k][:3, 3] for k, vertex in zip(owner, shaped, strict=True)
    ]
    return np.array([pose[:3, 3] for pose in world]) + trans_m, np.array(vertices) + trans_m


def test_posed_model_is_skinned_as_the_paper_has_it(file: Path) -> None:
    random, arrays = np.random.default_rng(1), synthetic()
    betas, trans_m = random.normal(size=10), random.normal(size=(1, 3))
    turns = Rotation.from_rotvec(0.4 * random.normal(size=(NUM_BODY, 3))).as_matrix()
    joints_m, points_m = read_model(file, LANDMARKS).posed(betas, turns[None], trans_m)
    expected_m, vertices_m = skinned(arrays, betas, turns, trans_m[0])
    np.testing.assert_allclose(joints_m[0], expected_m[:NUM_BODY], atol=1e-9)
    np.testing.assert_allclose(points_m[0], vertices_m[-len(LANDMARKS) :], atol=1e-9)


def targets(model: SmplxModel, betas: np.ndarray, turns: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    joints_m, points_m = model.posed(betas, turns, np.tile([1.0, 2.0, 0.9], (len(turns), 1)))
    return {name: joints_m[:, SMPLX_JOINTS.index(JOINT_MAP[name][0])] for name in FITTED}, points_m


def test_shape_and_pose_come_back_from_joints_and_points(file: Path) -> None:
    random, model = np.random.default_rng(2), read_model(file, LANDMARKS)
    vectors = 0.3 * random.normal(size=(5, NUM_BODY, 3))
    betas = np.r_[1.0, -0.8, np.zeros(8)]
    joints_m, points_m = targets(
        model, betas, Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(5, -1, 3, 3)
    )
    points_m[2, 0] = np.nan
    start = np.zeros((5, len(SMPLX_JOINTS), 3))
    start[:, :NUM_BODY] = vectors + 0.1 * random.normal(size=vectors.shape)
    found = fit_body(model, joints_m, points_m, start)
    np.testing.assert_allclose(found.betas[:2], betas[:2], atol=0.2)
    assert np.nanmax(found.error_m) < 0.01
    assert np.isnan(found.error_m[2, len(FITTED)])
    assert np.nanmedian(found.error_m) < 0.002
    knee = SMPLX_JOINTS.index("left_knee")
    between = Rotation.from_rotvec(found.poses[:, knee]) * Rotation.from_rotvec(vectors[:, knee]).inv()
    assert np.degrees(between.magnitude()).max() < 10.0


def person_arrays(file: Path) -> dict[str, np.ndarray]:
    """Arrays of a person's NPZ, whose joints and points are a model's."""
    model = read_model(file, LANDMARKS)
    joints_m, points_m = targets(model, np.zeros(10), np.tile(np.eye(3), (4, NUM_BODY, 1, 1)))
    facts = {"gender": "neutral", "surface_model_type": "smplx", "mocap_frame_rate": 25.0, "pose_names": SMPLX_JOINTS}
    return {
        **{name: np.array(value) for name, value in facts.items()},
        "frame": np.arange(4),
        "is_present": np.ones(4, bool),
        "poses": np.zeros((4, 165)),
        "joint_names": np.array(FITTED),
        "joints_m": np.stack([joints_m[name] for name in FITTED], axis=1),
        "landmark_names": np.array(LANDMARKS),
        "landmarks_m": points_m,
    }


def test_command_writes_fitted_body_beside_file(file: Path, tmp_path: Path) -> None:
    content = person_arrays(file)
    (tmp_path / "person-1.npz").write_bytes(encode_arrays(content))
    arguments = ["bodies", "fit", str(tmp_path / "person-1.npz"), "--body-model", str(file)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    with np.load(tmp_path / "person-1.smplx.npz", allow_pickle=False) as fitted:
        assert (fitted["poses"].shape, fitted["betas"].shape, fitted["trans"].shape) == ((4, 165), (10,), (4, 3))
        assert np.abs(fitted["betas"]).max() < 0.1
        np.testing.assert_allclose(fitted["trans"], np.tile([1.0, 2.0, 0.9], (4, 1)), atol=0.01)
    refused = CliRunner().invoke(app, [*arguments[:3], "--body-model", str(tmp_path / "person-1.npz")])
    assert refused.exit_code != 0
    assert "no NPZ model of SMPL-X" in refused.output
    assert "Traceback" not in refused.output


@pytest.mark.parametrize("number", [10, pytest.param(100, marks=pytest.mark.slow)])
def test_mutated_models_are_read_or_refused(file: Path, tmp_path: Path, number: int) -> None:
    whole, damaged, random = file.read_bytes(), tmp_path / "model.npz", np.random.default_rng(5)
    messages: list[str] = []
    for _ in range(number):
        damaged.write_bytes(mutated(whole, random))
        try:
            read_model(damaged, LANDMARKS)
        except InputError as error:
            messages += [error.problems[0].message]
    assert messages
    assert all(message.startswith("The file is no NPZ model of SMPL-X: ") for message in messages)


def fit_of(content: bytes, folder: Path) -> str:
    """Output of the command for a person's file and a model that is missing; a trace is an error."""
    (folder / "person-1.npz").write_bytes(content)
    arguments = ["bodies", "fit", str(folder / "person-1.npz"), "--body-model", str(folder / "none.npz")]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, SystemExit), result.exception
    return " ".join(result.output.split())


@pytest.mark.parametrize("number", [10, pytest.param(100, marks=pytest.mark.slow)])
def test_mutated_people_are_read_or_refused(file: Path, tmp_path: Path, number: int) -> None:
    """The model is asked for after the person, and is missing."""
    whole, random = encode_arrays(person_arrays(file)), np.random.default_rng(6)
    assert "no NPZ model of SMPL-X: it does not exist" in fit_of(whole, tmp_path)
    outputs = {fit_of(mutated(whole, random), tmp_path) for _ in range(number)}
    assert any("The file is no NPZ of a person: " in output for output in outputs)
    assert all("The file is no NPZ" in output for output in outputs)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("landmarks_m", np.zeros((4, 2, 3))),
        ("landmark_names", np.array(["tail"] * 7)),
        ("joint_names", np.array("Hips")),
        ("joints_m", np.array(1.0)),
        ("frame", np.array(4)),
        ("poses", np.full((4, 165), np.nan)),
    ],
)
def test_person_of_other_arrays_is_refused(file: Path, tmp_path: Path, name: str, array: np.ndarray) -> None:
    output = fit_of(encode_arrays(person_arrays(file) | {name: array}), tmp_path)
    assert "The file is no NPZ of a person: its" in output


@pytest.mark.parametrize("name", ["v_template", "shapedirs", "kintree_table"])
def test_model_of_single_numbers_is_refused(file: Path, tmp_path: Path, name: str) -> None:
    names = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table")
    with np.load(file) as arrays:
        content = {each: arrays[each] for each in names} | {name: np.array(1.0)}
    (tmp_path / "model.npz").write_bytes(encode_arrays(content))
    with pytest.raises(InputError, match="no NPZ model of SMPL-X"):
        read_model(tmp_path / "model.npz", LANDMARKS)
