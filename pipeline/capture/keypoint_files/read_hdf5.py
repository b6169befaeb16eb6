"""Read an HDF5 file of 2D points: ``python -m pipeline.capture.keypoint_files.read_hdf5 FILE``, a confined program.

It prints what ``tracks.decoded`` reads.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pipeline.calibration.readers.pickles import read_values
from pipeline.capture.keypoint_files.people import KeypointsError, check_frames, frame_number, number_in_name
from pipeline.capture.keypoint_files.points import named_layout
from pipeline.capture.keypoint_files.readers.deeplabcut import find_columns
from pipeline.capture.keypoint_files.readers.hdf5 import Tracks, encoded, problem
from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime.confinement import confined_arguments, tell_ready

MAX_DATASET_BYTES = 512 * 2**20
"""Limit on the size of a dataset, unpacked."""
_MAX_CHUNK_BYTES = 256 * 2**20
_MAX_ATTRIBUTE_BYTES = 2**20
_MAX_LINKS = 10_000
_MAX_FILTERS = 4
# Deflate, shuffle, Fletcher's checksum; and LZF of h5py.
_FILTERS = {1, 2, 3, 32000}
_AGAIN = "write the file again without other compression than gzip"


def opened(path: Path) -> h5py.File:
    """Open a file for reading, without a lock."""
    return h5py.File(path, "r", driver="sec2", locking=False)


def names_in(group: h5py.Group) -> list[str]:
    """Names in a group; raises ``KeypointsError`` if there are too many."""
    if len(group) > _MAX_LINKS:
        raise KeypointsError(f"The HDF5 file has a group of {len(group):,} names; at most {_MAX_LINKS:,} are read.")
    return list(group)


def node(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | None:
    """Group or dataset with a name in a group; ``None`` without one.

    Raises ``KeypointsError`` if it lies in another file.
    """
    link = group.get(name, getlink=True)
    if link is None:
        return None
    if isinstance(link, h5py.ExternalLink):
        raise KeypointsError(f"{name[:40]} of the HDF5 file lies in another file. Write everything into one file.")
    if not isinstance(link, h5py.HardLink):
        raise KeypointsError(f"{name[:40]} of the HDF5 file is a link. Write the data themselves in its place.")
    found = group[name]
    return found if isinstance(found, h5py.Group | h5py.Dataset) else None


def dataset(group: h5py.Group, name: str) -> h5py.Dataset | None:
    """Dataset with a name in a group, of which all may be read; ``None`` without one.

    Raises ``KeypointsError`` if its data lie in other files, are too many, or are packed by an unknown filter.
    """
    found = node(group, name)
    if not isinstance(found, h5py.Dataset):
        return None
    if found.is_virtual or found.external:
        raise KeypointsError(f"{name} of the HDF5 file lies in other files. Write everything into one file.")
    unpacked_bytes = found.size * found.dtype.itemsize if found.size else 0
    chunk_bytes = int(np.prod(found.chunks or [0], dtype=np.float64)) * found.dtype.itemsize
    if unpacked_bytes > MAX_DATASET_BYTES or chunk_bytes > _MAX_CHUNK_BYTES:
        limit = f"{MAX_DATASET_BYTES // 2**20} MiB at most, in chunks of {_MAX_CHUNK_BYTES // 2**20} MiB"
        raise KeypointsError(f"{name} of the HDF5 file is too large: {limit}.")
    properties = found.id.get_create_plist()
    filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
    if len(filters) > _MAX_FILTERS or not _FILTERS.issuperset(filters):
        raise KeypointsError(f"{name} of the HDF5 file is packed by a filter that is not read; {_AGAIN}.")
    return found


def values(group: h5py.Group, name: str) -> np.ndarray | None:
    """All values of a dataset; ``None`` without one."""
    found = dataset(group, name)
    return None if found is None else np.asarray(found[()])


def attribute(owner: h5py.Group | h5py.Dataset, name: str) -> Any:
    """Value of an attribute; ``None`` without one, or if it is too large."""
    if name not in owner.attrs:
        return None
    if owner.attrs.get_id(name).get_storage_size() > _MAX_ATTRIBUTE_BYTES:
        return None
    return owner.attrs[name]


def text(value: Any) -> str | None:
    """Text of a value; ``None`` if it is none."""
    if isinstance(value, bytes):
        return value.decode("utf-8")
    return str(value) if isinstance(value, str) else None


def texts(array: np.ndarray | None) -> list[str]:
    """Texts of an array; raises ``KeypointsError`` if it has other values."""
    found = [text(value) for value in ([] if array is None else array.ravel().tolist())]
    names = [name for name in found if name is not None]
    if len(names) < len(found):
        raise KeypointsError("Names in the HDF5 file are not texts.")
    return names


_LEVELS: Mapping[int, tuple[str, ...]] = {
    3: ("scorer", "bodyparts", "coords"),
    4: ("scorer", "individuals", "bodyparts", "coords"),
}
_MAX_LEVELS, _MAX_BLOCKS = 4, 100
_KEY = "df_with_missing"


def find_table(file: h5py.File) -> h5py.Group | None:
    """Group of pandas' table; ``None`` without one. DeepLabCut's own name goes first."""
    groups = {name: found for name in names_in(file) if isinstance(found := node(file, name), h5py.Group)}
    tables = {name: group for name, group in groups.items() if text(attribute(group, "pandas_type")) is not None}
    if len(tables) > 1 and _KEY not in tables:
        raise KeypointsError(f"The HDF5 file has several tables: {', '.join(list(tables)[:3])}. Keep one of them.")
    return tables.get(_KEY, next(iter(tables.values()), None))


def read_table(group: h5py.Group) -> Tracks:
    """Read a table: its points that are joints, by frames.

    Raises ``KeypointsError`` if the table can't be used, ``UnreadableError`` if it is damaged.
    """
    is_table = text(attribute(group, "pandas_type")) == "frame_table"
    rows, labels, numbers = _of_table(group) if is_table else _of_fixed(group)
    check_frames(len(rows))
    if numbers.shape != (len(rows), len(labels)):
        raise UnreadableError
    columns = find_columns(_headers(labels))
    frames = [_row_frame(row) for row in rows]
    numbers = np.pad(numbers, ((0, 0), (0, 1)), constant_values=np.nan)
    points, scene = (columns.points(numbers, number) for number in (columns.number, columns.scene_number))
    return Tracks("DeepLabCut", frames, points, columns.parts, scene, columns.scene)


def _headers(labels: Sequence[Sequence[str]]) -> Mapping[str, list[str]]:
    """Rows of headers, as in the CSV, of the labels of each column."""
    levels = {len(of_column) for of_column in labels}
    names = _LEVELS.get(max(levels, default=0), ())
    if len(levels) != 1 or not names:
        raise KeypointsError("The columns of the table must have the levels scorer, individuals, bodyparts, coords.")
    return {name: [of_column[k] for of_column in labels] for k, name in enumerate(names)}


def _row_frame(row: int | str) -> int:
    number = row if isinstance(row, int) else number_in_name(row)
    return frame_number(row if number is None else number, "index")


_Table = tuple[Sequence[int | str], Sequence[Sequence[str]], np.ndarray]
"""Labels of rows, labels of columns by their levels, and numbers: rows x columns."""


def _of_table(group: h5py.Group) -> _Table:
    table = dataset(group, "table")
    names = table.dtype.names if table is not None else None
    if table is None or not names or "index" not in names:
        raise UnreadableError
    labels: list[Sequence[str]] = []
    blocks: list[np.ndarray] = []
    for name in [name for name in names if name.startswith("values_block_")][:_MAX_BLOCKS]:
        kind = attribute(table, f"{name}_kind")
        if not isinstance(kind, bytes) or table.dtype[name].base.kind not in "fiu":
            raise UnreadableError
        labels += _pickled_labels(kind)
        blocks.append(np.asarray(table.fields(name)[()], np.float64).reshape(len(table), -1))
    if not blocks:
        raise UnreadableError
    return _row_labels(np.asarray(table.fields("index")[()])), labels, np.concatenate(blocks, axis=1)


def _pickled_labels(content: bytes) -> list[Sequence[str]]:
    labels = read_values(content)
    if not isinstance(labels, list) or not all(isinstance(of_column, list) for of_column in labels):
        raise UnreadableError
    if not all(isinstance(label, str) for of_column in labels for label in of_column):
        raise KeypointsError("The labels of the table's columns must be texts.")
    return labels


def _of_fixed(group: h5py.Group) -> _Table:
    num_blocks = attribute(group, "nblocks")
    if not isinstance(num_blocks, np.integer) or not 1 <= num_blocks <= _MAX_BLOCKS:
        raise UnreadableError
    labels: list[Sequence[str]] = []
    blocks: list[np.ndarray] = []
    for k in range(int(num_blocks)):
        numbers = values(group, f"block{k}_values")
        if numbers is None or numbers.ndim != 2 or numbers.dtype.kind not in "fiu":
            raise UnreadableError
        labels += list(zip(*map(texts, _levels(group, f"block{k}_items")), strict=True))
        blocks.append(numbers.astype(np.float64, copy=False))
    # Of several levels, which are the folders and the name of a picture, the last one has the number.
    return _row_labels(_levels(group, "axis1")[-1]), labels, np.concatenate(blocks, axis=1)


def _levels(group: h5py.Group, name: str) -> list[np.ndarray]:
    """Labels of an axis, by level."""
    plain = values(group, name)
    if plain is not None:
        return [plain]
    levels = []
    for k in range(_MAX_LEVELS):
        known, codes = values(group, f"{name}_level{k}"), values(group, f"{name}_label{k}")
        if known is None or codes is None:
            break
        if codes.dtype.kind not in "iu" or codes.ndim != 1 or ((codes < 0) | (codes >= len(known))).any():
            raise UnreadableError
        levels.append(known[codes])
    if not levels:
        raise UnreadableError
    return levels


def _row_labels(labels: np.ndarray) -> Sequence[int | str]:
    if labels.ndim != 1:
        raise UnreadableError
    return labels.tolist() if labels.dtype.kind in "iu" else texts(labels)


_AXES = ("frame", "track", "node", "xy")
_MATLAB = ("track", "xy", "node", "frame")
_UNTURNED = ("frame", "node", "xy", "track")


def is_analysis(file: h5py.File) -> bool:
    """Test for the arrays of an analysis in a file."""
    return {"tracks", "node_names"} <= set(names_in(file))


def read_analysis(file: h5py.File) -> Tracks:
    """Read the tracks of the points that are joints; frames count from 0.

    Raises ``KeypointsError`` if the arrays can't be used, ``UnreadableError`` if they are damaged.
    """
    names = texts(values(file, "node_names"))
    tracks = dataset(file, "tracks")
    if tracks is None or tracks.dtype.kind not in "fiu":
        raise UnreadableError
    axes = _read_axes(file, tracks)
    sizes = dict(zip(axes, tracks.shape, strict=False))
    if len(axes) != tracks.ndim or (sizes["node"], sizes["xy"]) != (len(names), 2):
        shape = " x ".join(map(str, tracks.shape))
        raise KeypointsError(f"tracks is {shape}; {' x '.join(axes)} of {len(names)} nodes are required.", "tracks")
    check_frames(sizes["frame"])
    positions = _turned(np.asarray(tracks[()], np.float64), axes, _AXES)
    scores = np.ones(positions.shape[:3])
    stored = values(file, "point_scores")
    if stored is not None and stored.dtype.kind in "fiu":
        of_scores = [axis for axis in axes if axis != "xy"]
        if stored.shape != tuple(sizes[axis] for axis in of_scores):
            raise KeypointsError("point_scores has other sizes than tracks.", "point_scores")
        stored = _turned(stored.astype(np.float64), of_scores, _AXES[:3])
        scores = np.where(np.isnan(stored), 1.0, stored)
    named_layout(names, "node_names")
    points = np.concatenate([positions, scores[..., None]], axis=-1)
    return Tracks("SLEAP", range(sizes["frame"]), points, names)


def _read_axes(file: h5py.File, tracks: h5py.Dataset) -> Sequence[str]:
    stated = text(attribute(tracks, "dims"))
    if stated is not None:
        try:
            axes = json.loads(stated)
        except ValueError as error:
            raise UnreadableError from error
        if not isinstance(axes, list) or sorted(map(str, axes)) != sorted(_AXES):
            raise KeypointsError(f"dims must list the axes {', '.join(_AXES)}.", "dims")
        return axes
    turned = attribute(file, "transpose")
    return _MATLAB if turned is None or turned else _UNTURNED


def _turned(array: np.ndarray, axes: Sequence[str], wanted: Sequence[str]) -> np.ndarray:
    return array.transpose([axes.index(axis) for axis in wanted])


_PROJECT = {"instances", "pred_points", "points"}
_PROJECT_ADVICE = (
    "The file is SLEAP's project. Give its analysis file, which is read: Export Analysis HDF5 in SLEAP's menu, "
    "sleap-convert --format analysis, or save_analysis_h5 of sleap-io."
)


def read(path: Path) -> Tracks:
    """Read a file; raises ``KeypointsError`` for other contents, and all kinds of exceptions if it is damaged."""
    with opened(path) as file:
        if is_analysis(file):
            return read_analysis(file)
        if (table := find_table(file)) is not None:
            return read_table(table)
        names = names_in(file)
        if set(names) >= _PROJECT:
            raise KeypointsError(_PROJECT_ADVICE)
        shown = ", ".join(name[:40] for name in names[:5]) or "nothing"
    raise KeypointsError(f"The HDF5 file has neither DeepLabCut's table nor SLEAP's tracks; it has {shown}.")


def answer(path: Path) -> bytes:
    """Encoded tracks of a file, or its problem."""
    try:
        return encoded(read(path))
    except KeypointsError as error:
        return problem(str(error), error.field)
    except MemoryError:
        return problem("The HDF5 file needs more memory than a file may.")
    except Exception:  # HDF5 and h5py raise all kinds of exceptions for a damaged file
        return problem(None)


def main() -> None:
    """Print the answer about the file."""
    (path,) = confined_arguments()
    tell_ready()
    sys.stdout.buffer.write(answer(Path(path)))


if __name__ == "__main__":
    main()
