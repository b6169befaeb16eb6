"""Objects of an FBX file that was read: their settings, their connections, and the curves of an animation."""

from collections import defaultdict
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
from jaxtyping import Float32, Int64

from pipeline.export.writers.fbx_nodes import ArrayProperty, FbxError, Node, Property
from pipeline.export.writers.fbx_scene import SEPARATOR, SETTINGS

_Value = TypeVar("_Value", int, float, str, ArrayProperty)
# Connections of an object to another one, and to a setting of it.
_CONNECTIONS = ("OO",), ("OP",)
# Values of a setting follow its name, type, label and flags.
_FIRST_VALUE = 4


class StoredScene:
    """Objects of a file by their ids, in the file's order.

    Objects without an id, and connections of other kinds than the writer's, are left out. Methods raise ``FbxError``
    if the file lacks what they look for.
    """

    def __init__(self, nodes: tuple[Node, ...]) -> None:
        objects = _top_node(nodes, "Objects").children
        self.objects = {typed_property(node, 0, int): node for node in objects if _has_id(node)}
        self.global_settings = _top_node(nodes, "GlobalSettings")
        # Children of each object, and the setting to which a child is connected; "" for the object itself.
        self._children: defaultdict[int, list[tuple[int, str]]] = defaultdict(list)
        self._parents: defaultdict[int, list[int]] = defaultdict(list)
        for node in _top_node(nodes, "Connections").children:
            if node.properties[:1] not in _CONNECTIONS:
                continue
            of_setting = typed_property(node, 3, str) if typed_property(node, 0, str) == "OP" else ""
            child, parent = typed_property(node, 1, int), typed_property(node, 2, int)
            self._children[parent].append((child, of_setting))
            if not of_setting:
                self._parents[child].append(parent)

    def find_all(self, kind: str, subclass: str) -> dict[int, Node]:
        """Objects of a kind, such as ``Model``, and of a subclass, such as ``LimbNode``; "" is the only one of many."""
        return {
            number: node
            for number, node in self.objects.items()
            if node.name == kind and typed_property(node, 2, str) == subclass
        }

    def parent(self, child: int, kind: str) -> int | None:
        """Object of a kind to which an object is connected; ``None`` if there is none."""
        parents = (parent for parent in self._parents[child] if parent in self.objects)
        return next((parent for parent in parents if self.objects[parent].name == kind), None)

    def children(self, parent: int, kind: str, of_setting: str = "") -> Iterator[int]:
        """Objects of a kind that are connected to an object, or to one of its settings."""
        for child, to_setting in self._children[parent]:
            if to_setting == of_setting and child in self.objects and self.objects[child].name == kind:
                yield child

    def curves(
        self, layer: int, model: int, of_setting: str
    ) -> tuple[list[Int64[np.ndarray, " keys"]], list[Float32[np.ndarray, " keys"]]] | None:
        """Times in ticks and values of the curves of X, Y and Z of a setting of a model; ``None`` without curves."""
        in_layer = set(self.children(layer, "AnimationCurveNode"))
        node = next((node for node in self.children(model, "AnimationCurveNode", of_setting) if node in in_layer), None)
        if node is None:
            return None
        times, values = [], []
        for axis in "XYZ":
            curve = next(self.children(node, "AnimationCurve", f"d|{axis}"), None)
            if curve is None:
                raise FbxError(f"{of_setting} lacks the curve of {axis}")
            times.append(_array(self.objects[curve], "KeyTime", "l"))
            values.append(_array(self.objects[curve], "KeyValueFloat", "f"))
            if len(times[-1]) != len(values[-1]):
                raise FbxError("a curve has other times than values")
        return times, values


def _has_id(node: Node) -> bool:
    return bool(node.properties) and isinstance(node.properties[0], int)


def object_name(node: Node) -> str:
    """Name of an object, without its class."""
    return typed_property(node, 1, str).partition(SEPARATOR)[0]


def has_setting(node: Node, name: str) -> bool:
    """True if an object has a setting."""
    return _values(node, name) is not None


def numbers(node: Node, name: str, count: int) -> tuple[float, ...]:
    """Values of a setting of an object; ``FbxError`` if it has no such setting with as many numbers."""
    values = tuple(float(value) for value in _values(node, name) or () if isinstance(value, int | float))
    if len(values) != count or not np.isfinite(values).all():
        raise FbxError(f"{node.name} lacks {name}")
    return values


def _values(node: Node, name: str) -> tuple[Property, ...] | None:
    """Values of a setting of an object; ``None`` if it has no such setting."""
    children = (node.child(SETTINGS) or Node("")).children
    found = (setting.properties for setting in children if setting.properties[:1] == (name,))
    return next((values[_FIRST_VALUE:] for values in found), None)


def typed_property(node: Node, place: int, kind: type[_Value]) -> _Value:
    """Property of a node, of a type; ``FbxError`` if there is none."""
    value = node.properties[place] if place < len(node.properties) else None
    if not isinstance(value, kind):
        raise FbxError(f"{node.name} lacks a property")
    return value


def _top_node(nodes: tuple[Node, ...], name: str) -> Node:
    node = next((node for node in nodes if node.name == name), None)
    if node is None:
        raise FbxError(f"there are no {name}")
    return node


def _array(node: Node, name: str, code: str) -> np.ndarray:
    stored = typed_property(node.child(name) or Node(name), 0, ArrayProperty)
    if stored.code != code:
        raise FbxError(f"{name} has elements of the type {stored.code}")
    return stored.values()
