"""Scenes of FBX files: objects with settings, connections between them, axes, unit and clock.

Objects are of the classes of Autodesk's FBX SDK. A connection goes from an object to the object that it belongs to, or
to one of its settings. Times are counted in ticks.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from unicodedata import category

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.export.writers.fbx_nodes import CREATED, FILE_ID, ArrayProperty, Int64, Node, Property, array, late_array

TICKS_PER_S = 46_186_158_000
"""Units of time in a second."""

ROTATION_ORDERS = ("ZYX", "YZX", "XZY", "ZXY", "YXZ", "XYZ")
"""Axes of the intrinsic rotations of each number of ``RotationOrder``; FBX names them in the opposite order."""

SEPARATOR = "\x00\x01"
"""Separator of the name of an object and its class."""

SCENE = Int64(0)
"""Id of the scene, to which objects at the top are connected."""

SETTINGS = "Properties70"
"""Name of the node with the settings of an object."""

TRANSLATION, ROTATION = "Lcl Translation", "Lcl Rotation"
"""Settings of a model: its place and rotation in its parent."""

VISIBILITY = "Visibility"
"""Setting of a model: 1 if it is drawn, else 0."""

_CREATOR = "Multicap"
_FIRST_ID = 1_000_000
_AXES = "XYZ"
_UNSAFE = frozenset({"Cc", "Cs"})
# Numbers of ``TimeMode`` by rate; every other rate is in ``CustomFrameRate``.
_TIME_MODES: Mapping[float, int] = MappingProxyType(
    {
        **{120.0: 1, 100.0: 2, 60.0: 3, 50.0: 4, 48.0: 5, 30.0: 6, 30000 / 1001: 9, 25.0: 10, 24.0: 11, 1000.0: 12},
        **{24000 / 1001: 13, 96.0: 15, 72.0: 16, 60000 / 1001: 17, 120000 / 1001: 18},
    }
)
_CUSTOM_TIME_MODE, _SAME_RATE = 14, 1e-9
# Flags of values that are interpolated linearly or hold until the next key, and numbers of the unused tangents, as the
# FBX SDK writes them.
_LINEAR_FLAGS, _CONSTANT_FLAGS = 0x6104, 0x6102
_TANGENTS = (0.0, 0.0, 9.419963346924634e-30, 0.0)
# Names of the nodes of curves.
_CURVES_OF = {TRANSLATION: "T", ROTATION: "R"}


def setting(name: str, kind: str, label: str, *values: Property, flags: str = "") -> Node:
    """Setting of an object: its name, type and values. The flag ``A`` is of those with curves, ``U`` of users' own."""
    return Node("P", (name, kind, label, flags, *values))


def number(name: str, size: float, flags: str = "") -> Node:
    """Setting that is a number."""
    return setting(name, "double", "Number", float(size), flags=flags)


def integer(name: str, size: int, flags: str = "") -> Node:
    """Setting that is an integer."""
    return setting(name, "int", "Integer", int(size), flags=flags)


def choice(name: str, size: int) -> Node:
    """Setting that is one of some numbered values."""
    return setting(name, "enum", "", int(size))


def vector(name: str, xyz: Iterable[float], kind: str = "Vector3D", label: str = "Vector", flags: str = "") -> Node:
    """Setting that has three numbers."""
    return setting(name, kind, label, *(float(part) for part in xyz), flags=flags)


def local(name: str, xyz: Iterable[float]) -> Node:
    """Setting ``TRANSLATION`` or ``ROTATION`` of a model."""
    return vector(name, xyz, name, "", "A")


def visible(is_visible: bool) -> Node:
    """Setting of a model: whether it is drawn."""
    return setting(VISIBILITY, VISIBILITY, "", float(is_visible), flags="A")


def settings(*nodes: Node) -> Node:
    """All settings of an object."""
    return Node(SETTINGS, (), nodes)


def safe_name(name: str) -> str:
    """Name without control characters, which files need as separators, and without halves of characters."""
    return "".join(" " if category(letter) in _UNSAFE else letter for letter in name).strip()


def ticks(num_frames: int, frame_rate_hz: float) -> Int[np.ndarray, " frames"]:
    """Times in ticks of the first frames of an animation."""
    return np.rint(np.arange(num_frames) * (TICKS_PER_S / frame_rate_hz)).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Animation with a key in each frame."""

    name: str
    layer: Int64  # Object to which curves belong
    ticks: Int[np.ndarray, " frames"]  # Times of the frames
    # Arrays of every curve; one of each stands for all
    times: ArrayProperty
    counts: ArrayProperty


class FbxScene:
    """Objects of a file and their connections, in the order in which they are added.

    A file has its own unit and Y up.
    """

    def __init__(self, frame_rate_hz: float, units_per_m: float) -> None:
        self._rate_hz, self._units_per_m = frame_rate_hz, units_per_m
        self._objects: list[Node] = []
        self._connections: list[Node] = []
        self._clips: list[Clip] = []
        self._flags, self._data = array("i", [_LINEAR_FLAGS]), array("f", _TANGENTS)

    def add(self, kind: str, name: str, of_class: str, subclass: str, *children: Node) -> Int64:
        """Add an object; return its id."""
        number_of_object = Int64(_FIRST_ID + len(self._objects))
        head = number_of_object, f"{name}{SEPARATOR}{of_class}", subclass
        self._objects.append(Node(kind, head, children))
        return number_of_object

    def connect(self, child: Int64, parent: Int64, of_setting: str | None = None) -> None:
        """Connect an object to the object that it belongs to, or to a setting of it."""
        ends = ("OO", child, parent) if of_setting is None else ("OP", child, parent, of_setting)
        self._connections.append(Node("C", ends))

    def add_model(self, name: str, subclass: str, parent: Int64, *nodes: Node) -> Int64:
        """Add a model, which has a place in the scene, below another one or ``SCENE``; ``nodes`` are settings."""
        model = self.add(
            *("Model", name, "Model", subclass),
            Node("Version", (232,)),
            settings(choice("InheritType", 1), integer("DefaultAttributeIndex", 0), *nodes),
            Node("Shading", (True,)),
            Node("Culling", ("CullingOff",)),
        )
        self.connect(model, parent)
        return model

    def add_bind_pose(self, name: str, file_from_model: Mapping[Int64, Float[np.ndarray, "4 4"]]) -> None:
        """Add the pose of models in which a skin is bound to them."""
        nodes = [
            Node("PoseNode", (), (Node("Node", (model,)), Node("Matrix", (matrix(transform),))))
            for model, transform in file_from_model.items()
        ]
        head = Node("Type", ("BindPose",)), Node("Version", (100,)), Node("NbPoseNodes", (len(nodes),))
        self.add("Pose", name, "Pose", "BindPose", *head, *nodes)

    def add_clip(self, name: str, num_frames: int) -> Clip:
        """Add an animation."""
        times = ticks(num_frames, self._rate_hz)
        last = _last(times)
        span = (("LocalStart", 0), ("LocalStop", last), ("ReferenceStart", 0), ("ReferenceStop", last))
        stack = self.add("AnimationStack", name, "AnimStack", "", settings(*(_time(*end) for end in span)))
        layer = self.add("AnimationLayer", name, "AnimLayer", "")
        self.connect(layer, stack)
        clip = Clip(name, layer, times, array("l", times), array("i", [num_frames]))
        self._clips.append(clip)
        return clip

    def animate(
        self,
        clip: Clip,
        model: Int64,
        of_setting: str,
        first: Float[np.ndarray, " 3"],
        values: Callable[[int], Float[np.ndarray, " frames"]],
    ) -> None:
        """Add the curves of a setting with three numbers, of ``TRANSLATION`` or ``ROTATION``.

        Programs interpolate values linearly between frames.

        ``first``: numbers in the first frame. ``values``: gives the numbers of X (0), Y (1) or Z (2) in all frames,
        when the curve is written.
        """
        defaults = settings(*(number(f"d|{axis}", start, "A") for axis, start in zip(_AXES, first, strict=True)))
        node = self.add("AnimationCurveNode", _CURVES_OF[of_setting], "AnimCurveNode", "", defaults)
        self.connect(node, clip.layer)
        self.connect(node, model, of_setting)
        for place, (axis, start) in enumerate(zip(_AXES, first, strict=True)):
            curve = self.add(
                *("AnimationCurve", "", "AnimCurve", ""),
                Node("Default", (float(start),)),
                Node("KeyVer", (4008,)),
                Node("KeyTime", (clip.times,)),
                Node("KeyValueFloat", (late_array("f", clip.times.length, partial(values, place)),)),
                Node("KeyAttrFlags", (self._flags,)),
                Node("KeyAttrDataFloat", (self._data,)),
                Node("KeyAttrRefCount", (clip.counts,)),
            )
            self.connect(curve, node, f"d|{axis}")

    def show(self, clip: Clip, model: Int64, is_visible: Bool[np.ndarray, " frames"]) -> None:
        """Add the curve of the visibility of a model in each frame, with a key where it changes."""
        (keys,) = np.nonzero(np.diff(is_visible, prepend=~is_visible[:1]))
        first = float(is_visible[0])
        channel = f"d|{VISIBILITY}"
        defaults = settings(setting(channel, VISIBILITY, "", first, flags="A"))
        node = self.add("AnimationCurveNode", VISIBILITY, "AnimCurveNode", "", defaults)
        self.connect(node, clip.layer)
        self.connect(node, model, VISIBILITY)
        curve = self.add(
            *("AnimationCurve", "", "AnimCurve", ""),
            Node("Default", (first,)),
            Node("KeyVer", (4008,)),
            Node("KeyTime", (array("l", clip.ticks[keys]),)),
            Node("KeyValueFloat", (array("f", is_visible[keys]),)),
            Node("KeyAttrFlags", (array("i", [_CONSTANT_FLAGS]),)),
            Node("KeyAttrDataFloat", (self._data,)),
            Node("KeyAttrRefCount", (array("i", [len(keys)]),)),
        )
        self.connect(curve, node, channel)

    def nodes(self, version: int) -> tuple[Node, ...]:
        """Nodes of a file of a version."""
        return (
            _header(version),
            Node("FileId", (FILE_ID,)),
            Node("CreationTime", (CREATED,)),
            Node("Creator", (_CREATOR,)),
            self._global_settings(),
            self._documents(),
            Node("References"),
            self._definitions(),
            Node("Objects", (), tuple(self._objects)),
            Node("Connections", (), tuple(self._connections)),
            self._takes(),
        )

    def _global_settings(self) -> Node:
        modes = (mode for rate_hz, mode in _TIME_MODES.items() if abs(rate_hz / self._rate_hz - 1.0) < _SAME_RATE)
        cm_per_unit = 100.0 / self._units_per_m
        axes = (("UpAxis", 1), ("UpAxisSign", 1), ("FrontAxis", 2), ("FrontAxisSign", 1), ("CoordAxis", 0))
        return Node(
            "GlobalSettings",
            (),
            (
                Node("Version", (1000,)),
                settings(
                    *(integer(name, axis) for name, axis in axes),
                    integer("CoordAxisSign", 1),
                    integer("OriginalUpAxis", 1),
                    integer("OriginalUpAxisSign", 1),
                    number("UnitScaleFactor", cm_per_unit),
                    number("OriginalUnitScaleFactor", cm_per_unit),
                    vector("AmbientColor", (0.0, 0.0, 0.0), "ColorRGB", "Color"),
                    setting("DefaultCamera", "KString", "", "Producer Perspective"),
                    choice("TimeMode", next(modes, _CUSTOM_TIME_MODE)),
                    _time("TimeSpanStart", 0),
                    _time("TimeSpanStop", max((_last(clip.ticks) for clip in self._clips), default=0)),
                    number("CustomFrameRate", self._rate_hz),
                ),
            ),
        )

    def _documents(self) -> Node:
        active = self._clips[0].name if self._clips else ""
        document = Node(
            "Document",
            (Int64(_FIRST_ID - 1), "", "Scene"),
            (
                settings(setting("SourceObject", "object", ""), setting("ActiveAnimStackName", "KString", "", active)),
                Node("RootNode", (SCENE,)),
            ),
        )
        return Node("Documents", (), (Node("Count", (1,)), document))

    def _definitions(self) -> Node:
        counts = Counter(node.name for node in self._objects)
        types = [("GlobalSettings", 1), *counts.items()]
        return Node(
            "Definitions",
            (),
            (
                Node("Version", (100,)),
                Node("Count", (sum(count for _, count in types),)),
                *(Node("ObjectType", (name,), (Node("Count", (count,)),)) for name, count in types),
            ),
        )

    def _takes(self) -> Node:
        takes = []
        for clip in self._clips:
            span = Int64(0), Int64(_last(clip.ticks))
            parts = Node("FileName", (f"{clip.name}.tak",)), Node("LocalTime", span), Node("ReferenceTime", span)
            takes.append(Node("Take", (clip.name,), parts))
        return Node("Takes", (), (Node("Current", (self._clips[0].name if self._clips else "",)), *takes))


def matrix(transform: Float[np.ndarray, "4 4"]) -> ArrayProperty:
    """Transform as files have it: a matrix, column by column."""
    return array("d", transform.T.reshape(-1))


def _last(times: Int[np.ndarray, " frames"]) -> int:
    return int(times.max(initial=0))


def _time(name: str, moment: int) -> Node:
    return setting(name, "KTime", "Time", Int64(moment))


def _header(version: int) -> Node:
    date, clock = CREATED.split(" ")
    parts = [int(part) for part in (*date.split("-"), *clock.split(":"))]
    names = ("Year", "Month", "Day", "Hour", "Minute", "Second", "Millisecond")
    created = (Node(name, (part,)) for name, part in zip(names, parts, strict=True))
    return Node(
        "FBXHeaderExtension",
        (),
        (
            Node("FBXHeaderVersion", (1003,)),
            Node("FBXVersion", (version,)),
            Node("EncryptionType", (0,)),
            Node("CreationTimeStamp", (), (Node("Version", (1000,)), *created)),
            Node("Creator", (_CREATOR,)),
        ),
    )
