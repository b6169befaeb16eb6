"""Coarse meshes: some of a mesh's vertices, and triangles between these.

Edges are collapsed in the order of their quadric errors (Garland and Heckbert, "Surface simplification using quadric
error metrics", 1997), always into one of their own vertices: it keeps its positions at all ages, and its joints. The
error is the error of several poses together (DeCoro and Rusinkiewicz, "Pose-independent simplification of articulated
meshes", 2005), so that joints keep the vertices that bends need.

All sums are of numbers of Python, one after the other: every machine makes the same mesh.
"""

from collections.abc import Iterator, Sequence
from heapq import heapify, heappop, heappush
from math import sqrt

import numpy as np
from jaxtyping import Int

# Weight of the planes that keep a border in place, relative to the triangles' planes.
_BORDER_WEIGHT = 10.0
# Least cosine between the normals of a triangle before and after a collapse.
_MIN_COSINE = 0.2

Vector = Sequence[float]  # of three
Quadric = list[float]
Entry = tuple[float, int, int, int, int]


def coarsen(
    poses: Int[np.ndarray, "poses vertices 3"], triangles: Int[np.ndarray, "triangles 3"], num_triangles: int
) -> Int[np.ndarray, "coarse_triangles 3"]:
    """Triangles of a coarse mesh, as indices of the given vertices.

    ``poses``: positions of the vertices in each pose, in any unit. Triangles keep their sides in the first one.
    ``triangles``: triangles of a mesh in which at most two meet at an edge; with the same vertices in all poses.
    ``num_triangles``: largest number of triangles; more are left only if no edge can be collapsed any more.
    """
    mesh = _Mesh(poses.tolist(), triangles.tolist())
    while mesh.num_triangles > num_triangles and mesh.collapse_next():
        pass
    return np.array([corners for corners in mesh.triangles if corners is not None]).reshape(-1, 3)


class _Mesh:
    """Mesh whose edges are collapsed one after the other."""

    def __init__(self, poses: Sequence[Sequence[Vector]], triangles: list[list[int]]) -> None:
        self.triangles: list[list[int] | None] = list(triangles)
        self.num_triangles = len(triangles)
        self._poses = poses
        self._of_vertex: list[set[int]] = [set() for _ in poses[0]]
        for number, corners in enumerate(triangles):
            for corner in corners:
                self._of_vertex[corner].add(number)
        self._quadrics = [self._pose_quadrics(positions) for positions in poses]
        # Number of the last change around each vertex: candidates of earlier ones are out of date.
        self._changes = [0] * len(poses[0])
        self._candidates = [
            self._candidate(vertex, onto) for vertex in range(len(poses[0])) for onto in self._neighbours(vertex)
        ]
        heapify(self._candidates)

    def collapse_next(self) -> bool:
        """Collapse the edge with the smallest error; return whether there is one."""
        while self._candidates:
            _, vertex, onto, *changes = heappop(self._candidates)
            is_valid = changes == [self._changes[vertex], self._changes[onto]] and self._can_collapse(vertex, onto)
            if is_valid:
                self._collapse(vertex, onto)
                return True
        return False

    def _collapse(self, vertex: int, onto: int) -> None:
        for number in sorted(self._of_vertex[vertex]):
            corners = self._corners(number)
            if onto in corners:
                for corner in corners:
                    self._of_vertex[corner].discard(number)
                self.triangles[number] = None
                self.num_triangles -= 1
            else:
                corners[corners.index(vertex)] = onto
                self._of_vertex[onto].add(number)
        self._of_vertex[vertex].clear()
        for quadrics in self._quadrics:
            quadrics[onto] = [one + other for one, other in zip(quadrics[onto], quadrics[vertex], strict=True)]
        for changed in (vertex, onto):
            self._changes[changed] += 1
        for neighbour in self._neighbours(onto):
            heappush(self._candidates, self._candidate(onto, neighbour))
            heappush(self._candidates, self._candidate(neighbour, onto))

    def _can_collapse(self, vertex: int, onto: int) -> bool:
        """True if the mesh stays a surface, and no triangle turns over."""
        shared = self._of_vertex[vertex] & self._of_vertex[onto]
        common = set(self._neighbours(vertex)) & set(self._neighbours(onto))
        # A vertex on a border only moves along the border.
        if not shared or len(common) != len(shared) or (self._is_on_border(vertex) and len(shared) > 1):
            return False
        positions = self._poses[0]
        for number in self._of_vertex[vertex] - shared:
            corners = self._corners(number)
            before = _normal(*(positions[corner] for corner in corners))
            after = _normal(*(positions[onto if corner == vertex else corner] for corner in corners))
            if _dot(before, after) <= _MIN_COSINE * sqrt(_dot(before, before) * _dot(after, after)):
                return False
        return True

    def _is_on_border(self, vertex: int) -> bool:
        return len(self._neighbours(vertex)) != len(self._of_vertex[vertex])

    def _neighbours(self, vertex: int) -> list[int]:
        corners = {corner for number in self._of_vertex[vertex] for corner in self._corners(number)}
        return sorted(corners - {vertex})

    def _corners(self, number: int) -> list[int]:
        corners = self.triangles[number]
        assert corners is not None  # noqa: S101 - triangles of vertices exist
        return corners

    def _candidate(self, vertex: int, onto: int) -> Entry:
        error = 0.0
        for positions, quadrics in zip(self._poses, self._quadrics, strict=True):
            error += _error(quadrics[vertex], positions[onto]) + _error(quadrics[onto], positions[onto])
        return (error, vertex, onto, self._changes[vertex], self._changes[onto])

    def _pose_quadrics(self, positions: Sequence[Vector]) -> list[Quadric]:
        """Quadrics of all vertices in a pose: of the planes of their triangles, and across their borders."""
        quadrics: list[Quadric] = [[0.0] * 10 for _ in positions]
        for number in range(len(self.triangles)):
            corners = self._corners(number)
            first, second, third = (positions[corner] for corner in corners)
            normal = _normal(first, second, third)
            doubled_area = sqrt(_dot(normal, normal))
            if doubled_area == 0.0:
                continue
            unit = (normal[0] / doubled_area, normal[1] / doubled_area, normal[2] / doubled_area)
            for corner in corners:
                _add_plane(quadrics[corner], unit, first, doubled_area)
            for start, end in self._borders(number, corners):
                along = _difference(positions[end], positions[start])
                across = _cross(along, unit)
                length = sqrt(_dot(along, along))
                if length:
                    plane = (across[0] / length, across[1] / length, across[2] / length)
                    for corner in (start, end):
                        _add_plane(quadrics[corner], plane, positions[start], _BORDER_WEIGHT * length * length)
        return quadrics

    def _borders(self, number: int, corners: list[int]) -> Iterator[tuple[int, int]]:
        for place in range(3):
            start, end = corners[place], corners[(place + 1) % 3]
            if self._of_vertex[start] & self._of_vertex[end] == {number}:
                yield start, end


def _add_plane(quadric: Quadric, normal: Vector, point: Vector, weight: float) -> None:
    """Add the squared distance from a plane, with a weight."""
    a, b, c = normal
    d = -_dot(normal, point)
    terms = (a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d)
    for place, term in enumerate(terms):
        quadric[place] += weight * term


def _error(quadric: Quadric, point: Vector) -> float:
    xx, xy, xz, xd, yy, yz, yd, zz, zd, dd = quadric
    x, y, z = point
    return (
        x * (xx * x + 2.0 * (xy * y + xz * z + xd)) + y * (yy * y + 2.0 * (yz * z + yd)) + z * (zz * z + 2.0 * zd) + dd
    )


def _normal(first: Vector, second: Vector, third: Vector) -> Vector:
    """Normal of a triangle, as long as the double of its area."""
    return _cross(_difference(second, first), _difference(third, first))


def _difference(one: Vector, other: Vector) -> Vector:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def _cross(one: Vector, other: Vector) -> Vector:
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
