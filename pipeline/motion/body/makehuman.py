"""MakeHuman's base mesh in the rest pose of the skeleton, at three ages.

MakeHuman's data are text files: a mesh, weights of a rig's bones, and targets, which move vertices of the mesh. The
mean of all origins and sexes is taken, of average muscles and weight. Only the skin and the eyes are kept.
"""

import gzip
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from pipeline.motion.body import joints as body_joints
from pipeline.motion.body.coarse import coarsen
from pipeline.motion.skeleton.model import INDEX, TRUNK, WHOLE_SKELETON

AGES = ("baby", "child", "young")
"""Ages of the shapes, ascending; the last is the adult."""

NUM_INFLUENCES = 4
"""Largest number of joints that move a vertex."""

UNITS_PER_M = 10_000
"""Stored positions are whole numbers of a tenth of a millimetre: rounding errors of processors don't change them."""

FULL_WEIGHT = 255
"""Sum of the weights of a vertex."""

NUM_COARSE_TRIANGLES = 1_500
"""Number of triangles of the coarse mesh."""

ReadText = Callable[[str], bytes]

_MESH = "3dobjs/base.obj"
_WEIGHTS = "rigs/standard/weights.game_engine.json"
_GROUPS = "mesh_metadata/basemesh_vertex_groups.json"
_TARGETS = "targets/macrodetails"
_ORIGINS, _SEXES = ("african", "asian", "caucasian"), ("female", "male")
_KEPT_GROUPS = ("body", "helper-l-eye", "helper-r-eye")
# The mesh is in decimetres, with Y up and facing +Z.
_M_PER_UNIT = 0.1
_WORLD_FROM_MESH = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# Bones of the rig that move what a joint of the skeleton moves; ``{s}`` is l or r.
_BONES: Mapping[str, tuple[str, ...]] = {
    "Hips": ("pelvis", "Root"),
    "Spine": ("spine_01", "spine_02"),
    "Chest": ("spine_03",),
    "Neck": ("neck_01",),
    "Head": ("head",),
    "{Side}Shoulder": ("clavicle_{s}",),
    "{Side}Arm": ("upperarm_{s}",),
    "{Side}ForeArm": ("lowerarm_{s}",),
    "{Side}Hand": ("hand_{s}",),
    "{Side}UpLeg": ("thigh_{s}",),
    "{Side}Leg": ("calf_{s}",),
    "{Side}Foot": ("foot_{s}", "ball_{s}"),
    **{
        f"{{Side}}Hand{finger.capitalize()}{part}": (f"{finger}_0{part}_{{s}}",)
        for finger in _FINGERS
        for part in (1, 2, 3)
    },
}
# Cubes of the mesh in whose middle a joint lies.
_CUBES: Mapping[str, str] = {
    "{Side}Arm": "joint-{s}-shoulder",
    "{Side}ForeArm": "joint-{s}-elbow",
    "{Side}Hand": "joint-{s}-hand",
    "{Side}HandEnd": "joint-{s}-finger-3-4",
    "{Side}UpLeg": "joint-{s}-upper-leg",
    "{Side}Leg": "joint-{s}-knee",
    "{Side}Foot": "joint-{s}-ankle",
    **{
        f"{{Side}}Hand{finger.capitalize()}{part}": f"joint-{{s}}-finger-{number}-{cube}"
        for number, finger in enumerate(_FINGERS, 1)
        for cube, part in enumerate(("1", "2", "3", "3End"), 1)
    },
}
# Turns (degrees, about the world's axes) of joints in the pose in which the coarse mesh keeps its shape too, beside the
# rest pose; of limbs those on the left side.
_BENDS: Mapping[str, tuple[float, float, float]] = {
    "Spine": (20.0, 0.0, 10.0),
    "Chest": (20.0, 0.0, 10.0),
    "Neck": (20.0, 0.0, 20.0),
    "LeftArm": (0.0, 70.0, 0.0),
    "LeftForeArm": (0.0, 0.0, -100.0),
    "LeftHand": (0.0, 40.0, 0.0),
    "LeftUpLeg": (-80.0, 0.0, 0.0),
    "LeftLeg": (100.0, 0.0, 0.0),
    "LeftFoot": (-25.0, 0.0, 0.0),
}
# Share of the head's half width within which vertices belong to the ears.
_EARS = 0.85


def members() -> tuple[str, ...]:
    """Names of the files that ``build`` reads."""
    return (_MESH, _WEIGHTS, _GROUPS, *(name for age in AGES for name, _ in _targets(age)))


def build(read: ReadText) -> Mapping[str, np.ndarray]:
    """Make the arrays of a body from MakeHuman's files; equal files give equal arrays.

    ``read``: gives the content of a file by its name, see ``members``. Raises ``KeyError``, ``ValueError`` if the files
    are not MakeHuman's.

    The result has:

    - ``vertices``: (ages, vertices, 3): positions in the rest pose, world axes, standing at the origin; see
      ``UNITS_PER_M``.
    - ``joints``: (ages, joints, 3): positions of the joints of ``BODY_JOINTS``, likewise.
    - ``triangles``: (triangles, 3): indices of vertices, counterclockwise from outside.
    - ``carriers``, ``weights``: (vertices, 4): positions in ``BODY_JOINTS`` of the joints that move a vertex, and their
      weights, whose sum is ``FULL_WEIGHT``.
    - ``coarse_triangles``: (coarse triangles, 3): the same surface with ``NUM_COARSE_TRIANGLES``, between some of the
      vertices.
    """
    points, quads = _read_mesh(read(_MESH))
    groups = json.loads(read(_GROUPS))
    kept = np.concatenate([_range_vertices(groups[name]) for name in _KEPT_GROUPS])
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    faces = number[quads]
    faces = faces[(faces >= 0).all(1)]
    influences = _influences(json.loads(read(_WEIGHTS))["weights"], len(points))[kept]
    shapes, joints, spread = [], [], None
    for age in AGES:
        aged = points.copy()
        for name, share in _targets(age):
            _move(aged, read(name), share)
        aged_m = aged @ _WORLD_FROM_MESH.T * _M_PER_UNIT
        skin_m = aged_m[kept]
        places_m = _joint_positions(aged_m, skin_m, groups)
        # The same for all ages, as weights are.
        spread = _with_twists(influences, skin_m, places_m) if spread is None else spread
        posed_m, rest_m = _pose(skin_m, spread, places_m)
        shapes.append(posed_m)
        joints.append(rest_m)
    assert spread is not None  # noqa: S101 - there are ages
    carriers, weights = _strongest(spread)
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    bent_m = _bend(shapes[-1], joints[-1], carriers, weights / FULL_WEIGHT)
    poses = np.rint(np.array([shapes[-1], bent_m]) * UNITS_PER_M).astype(int)
    return {
        "vertices": np.rint(np.array(shapes) * UNITS_PER_M).astype("<i2"),
        "joints": np.rint(np.array(joints) * UNITS_PER_M).astype("<i2"),
        "triangles": triangles.astype("<u2"),
        "carriers": carriers,
        "weights": weights,
        "coarse_triangles": coarsen(poses, triangles, NUM_COARSE_TRIANGLES).astype("<u2"),
    }


def _targets(age: str) -> Iterator[tuple[str, float]]:
    for sex in _SEXES:
        yield f"{_TARGETS}/universal-{sex}-{age}-averagemuscle-averageweight.target.gz", 1.0 / len(_SEXES)
        for origin in _ORIGINS:
            yield f"{_TARGETS}/{origin}-{sex}-{age}.target.gz", 1.0 / len(_SEXES) / len(_ORIGINS)


def _read_mesh(content: bytes) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "quads 4"]]:
    points, quads = [], []
    for line in content.decode().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            points.append([float(word) for word in words])
        elif kind == "f":
            quads.append([int(word.partition("/")[0]) - 1 for word in words])
    return np.array(points), np.array(quads)


def _move(points: Float[np.ndarray, "points 3"], content: bytes, share: float) -> None:
    """Add a share of a target's displacements to the points."""
    rows = [line.split() for line in gzip.decompress(content).decode().splitlines() if not line.startswith("#")]
    table = np.array([row for row in rows if row], dtype=float).reshape(-1, 4)
    points[table[:, 0].astype(int)] += share * table[:, 1:]


def _range_vertices(ranges: Sequence[tuple[int, int]]) -> Int[np.ndarray, " vertices"]:
    return np.concatenate([np.arange(first, last + 1) for first, last in ranges])


def _sides(name: str, *patterns: str) -> Iterator[tuple[str, ...]]:
    """Expand names with a side to the names of both sides."""
    for side in ("Left", "Right") if "{Side}" in name else ("",):
        yield tuple(pattern.format(Side=side, s=side[:1].lower()) for pattern in (name, *patterns))


def _influences(
    bones: Mapping[str, Sequence[tuple[int, float]]], num_points: int
) -> Float[np.ndarray, "points joints"]:
    """Weights of the joints of ``BODY_JOINTS``, none of them of twist joints."""
    weights = np.zeros((num_points, len(body_joints.BODY_JOINTS)))
    for pattern, names in _BONES.items():
        for joint, *sided in _sides(pattern, *names):
            for bone in sided:
                table = np.array(bones[bone], dtype=float).reshape(-1, 2)
                np.add.at(weights[:, body_joints.BODY_INDEX[joint]], table[:, 0].astype(int), table[:, 1])
    return weights


def _joint_positions(
    points_m: Float[np.ndarray, "points 3"],
    skin_m: Float[np.ndarray, "vertices 3"],
    groups: Mapping[str, Sequence[tuple[int, int]]],
) -> Mapping[str, Float[np.ndarray, " 3"]]:
    """Positions of the skeleton's joints in the mesh's own pose, world axes."""
    places: dict[str, Float[np.ndarray, " 3"]] = {}
    for pattern, group in _CUBES.items():
        for joint, cube in _sides(pattern, group):
            places[joint] = points_m[_range_vertices(groups[cube])].mean(0)
    places["Hips"] = 0.5 * (places["LeftUpLeg"] + places["RightUpLeg"])
    places["Neck"] = 0.5 * (places["LeftArm"] + places["RightArm"])
    shares = np.cumsum([WHOLE_SKELETON[INDEX[name]].stature_share for name in TRUNK])
    for name, share in zip(TRUNK[:-1], shares[:-1] / shares[-1], strict=True):
        places[name] = places["Hips"] + share * (places["Neck"] - places["Hips"])
    top_m = skin_m[:, 2].max()
    head_m = skin_m[skin_m[:, 2] > top_m - 0.75 * (top_m - places["Neck"][2])]
    half_width_m = np.abs(head_m[:, 0]).max()
    ears_m = head_m[np.abs(head_m[:, 0]) > _EARS * half_width_m].mean(0)
    places["Head"] = ears_m * [0.0, 1.0, 1.0]
    places["HeadEnd"] = np.array([0.0, ears_m[1], top_m])
    for side in ("Left", "Right"):
        places[f"{side}Shoulder"] = places["Neck"]
        # The foot is flat: its end is on the floor, at the skeleton's angle below the ankle.
        height_m = places[f"{side}Foot"][2] - skin_m[:, 2].min()
        along = np.array(WHOLE_SKELETON[INDEX[f"{side}FootEnd"]].rest_direction)
        places[f"{side}FootEnd"] = places[f"{side}Foot"] + along * height_m / -along[2]
    return places


def _with_twists(
    influences: Float[np.ndarray, "vertices joints"],
    skin_m: Float[np.ndarray, "vertices 3"],
    places_m: Mapping[str, Float[np.ndarray, " 3"]],
) -> Float[np.ndarray, "vertices joints"]:
    """Spread the weight of each forearm over it and its twist joints, by the way from the elbow to the wrist."""
    spread = influences.copy()
    for side in ("Left", "Right"):
        elbow_m, wrist_m = places_m[f"{side}ForeArm"], places_m[f"{side}Hand"]
        along_m = wrist_m - elbow_m
        knots = ((skin_m - elbow_m) @ along_m / (along_m @ along_m)).clip(0.0, 1.0) * (body_joints.NUM_TWISTS + 1)
        names = [
            f"{side}ForeArm",
            *(twist.name for twist in body_joints.TWIST_JOINTS if twist.parent == f"{side}ForeArm"),
        ]
        weight = influences[:, body_joints.BODY_INDEX[f"{side}ForeArm"]]
        for knot, name in enumerate(names):
            near = (1.0 - np.abs(knots.clip(max=body_joints.NUM_TWISTS) - knot)).clip(min=0.0)
            spread[:, body_joints.BODY_INDEX[name]] = weight * near
    return spread


def _pose(
    skin_m: Float[np.ndarray, "vertices 3"],
    spread: Float[np.ndarray, "vertices joints"],
    places_m: Mapping[str, Float[np.ndarray, " 3"]],
) -> tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "joints 3"]]:
    """Bend a mesh from its own pose to the rest pose of the skeleton; return its vertices and joints."""
    rest_m, turns = _rest_positions(places_m), _turns(places_m)
    for twist in body_joints.TWIST_JOINTS:
        forearm = turns[twist.parent]
        turn = turns[twist.hand] * forearm.inv()
        turns[twist.name] = Rotation.from_rotvec(twist.share * turn.as_rotvec()) * forearm
        elbow_m, wrist_m = rest_m[twist.parent], rest_m[twist.hand]
        rest_m[twist.name] = elbow_m + twist.share * (wrist_m - elbow_m)
    posed_m = np.zeros_like(skin_m)
    for number, name in enumerate(body_joints.BODY_JOINTS):
        moved = spread[:, number] > 0.0
        if moved.any():
            # Twist joints turn about the elbow, too: the way along the forearm does not change.
            pivot = next((twist.parent for twist in body_joints.TWIST_JOINTS if twist.name == name), name)
            turned_m = rest_m[pivot] + turns[name].apply(skin_m[moved] - places_m[pivot])
            posed_m[moved] += spread[moved, number, None] * turned_m
    posed_m /= spread.sum(1, keepdims=True)
    joints_m = np.array([rest_m[name] for name in body_joints.BODY_JOINTS])
    floor_m = np.array([0.0, 0.0, rest_m["LeftFootEnd"][2]])
    return posed_m - floor_m, joints_m - floor_m


def _bend(
    vertices_m: Float[np.ndarray, "vertices 3"],
    joints_m: Float[np.ndarray, "joints 3"],
    carriers: Int[np.ndarray, "vertices 4"],
    weights: Float[np.ndarray, "vertices 4"],
) -> Float[np.ndarray, "vertices 3"]:
    """Bend all joints of limbs, from the rest pose."""
    turns_deg = np.zeros((len(WHOLE_SKELETON), 3))
    for number, joint in enumerate(WHOLE_SKELETON):
        on_left = joint.name.replace("Right", "Left")
        # Fingers bend as the hand does.
        bend = _BENDS.get(on_left, _BENDS["LeftHand"] if on_left.startswith("LeftHand") else (0.0, 0.0, 0.0))
        mirror = (1.0, -1.0, -1.0) if joint.name.startswith("Right") else (1.0, 1.0, 1.0)
        turns_deg[number] = np.multiply(bend, mirror)
    world = body_joints.world_from_joints(Rotation.from_rotvec(turns_deg, degrees=True).as_quat())
    return body_joints.blend(
        vertices_m, carriers, weights, body_joints.about(world, joints_m, body_joints.placed(world, joints_m))
    )


def _rest_positions(places_m: Mapping[str, Float[np.ndarray, " 3"]]) -> dict[str, Float[np.ndarray, " 3"]]:
    """Positions of the skeleton's joints in its rest pose with the mesh's own lengths, the hips above the origin."""
    rest_m = {"Hips": np.zeros(3)}
    for joint in WHOLE_SKELETON[1:]:
        assert joint.parent is not None  # noqa: S101 - only the root has none
        way_m = places_m[joint.name] - places_m[joint.parent]
        # Heights of the trunk and the head count alone: the skeleton's spine is straight.
        length_m = abs(way_m[2]) if joint.name in {*TRUNK, "Head", "HeadEnd"} else float(np.linalg.norm(way_m))
        if joint.name.endswith("Shoulder"):
            rest_m[joint.name] = rest_m["Neck"]
        else:
            rest_m[joint.name] = rest_m[joint.parent] + length_m * np.array(joint.rest_direction)
    return rest_m


def _turns(places_m: Mapping[str, Float[np.ndarray, " 3"]]) -> dict[str, Rotation]:
    """Rotation of each joint from the mesh's own pose to the skeleton's rest pose."""
    turns = {joint.name: Rotation.identity() for joint in WHOLE_SKELETON}

    def turn(name: str, following: str, before: Rotation) -> None:
        """Turn a bone to its rest direction, by the shortest way from where its parent's turn brings it."""
        along = before.apply(places_m[following] - places_m[name])
        turns[name] = _shortest(along, np.array(WHOLE_SKELETON[INDEX[following]].rest_direction)) * before

    for side in ("Left", "Right"):
        turn(f"{side}Arm", f"{side}ForeArm", Rotation.identity())
        turn(f"{side}ForeArm", f"{side}Hand", turns[f"{side}Arm"])
        turns[f"{side}Hand"] = _hand_turn(places_m, side)
        for finger in (name.capitalize() for name in _FINGERS):
            before = turns[f"{side}Hand"]
            for joint, following in pairwise(f"{side}Hand{finger}{part}" for part in ("1", "2", "3", "3End")):
                turn(joint, following, before)
                before = turns[joint]
        turn(f"{side}UpLeg", f"{side}Leg", Rotation.identity())
        turn(f"{side}Leg", f"{side}Foot", turns[f"{side}UpLeg"])
    return turns


def _hand_turn(places_m: Mapping[str, Float[np.ndarray, " 3"]], side: str) -> Rotation:
    """Rotation of a hand: the middle finger's base outwards, and the bases of the fingers in a level row."""
    hand = f"{side}Hand"
    frames = []
    for along, forward in (
        (places_m[f"{hand}Middle1"] - places_m[hand], places_m[f"{hand}Index1"] - places_m[f"{hand}Pinky1"]),
        (np.array(WHOLE_SKELETON[INDEX[hand]].rest_direction), np.array([0.0, -1.0, 0.0])),
    ):
        first = along / np.linalg.norm(along)
        third = np.cross(first, forward)
        third /= np.linalg.norm(third)
        frames.append(np.column_stack([first, np.cross(third, first), third]))
    return Rotation.from_matrix(frames[1] @ frames[0].T)


def _shortest(start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]) -> Rotation:
    """Shortest rotation from a direction to another; ``end`` is a unit vector."""
    start = start / np.linalg.norm(start)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, start @ end)) if sine else Rotation.identity()


def _strongest(
    spread: Float[np.ndarray, "vertices joints"],
) -> tuple[UInt8[np.ndarray, "vertices 4"], UInt8[np.ndarray, "vertices 4"]]:
    """The strongest joints of each vertex and their weights in whole numbers."""
    carriers = np.argsort(-spread, axis=1, kind="stable")[:, :NUM_INFLUENCES]
    weights = np.take_along_axis(spread, carriers, 1)
    whole = np.floor(weights / weights.sum(1, keepdims=True) * FULL_WEIGHT + 0.5)
    # The strongest joint takes what rounding left.
    whole[:, 0] += FULL_WEIGHT - whole.sum(1)
    carriers[whole == 0.0] = 0
    return carriers.astype("u1"), whole.astype("u1")
