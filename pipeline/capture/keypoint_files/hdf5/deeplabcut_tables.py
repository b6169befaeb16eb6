"""DeepLabCut's HDF5: a table that pandas writes, in its forms ``table`` and ``fixed``.

A table has levels of labels for its columns (scorer, individuals of several people, body parts, coordinates), and
numbers or paths of pictures as labels of its rows. The form ``table`` has the labels of columns as pickles, which are
read without running them. Formats: https://pandas.pydata.org/docs (``DataFrame.to_hdf``), https://www.pytables.org
"""

from collections.abc import Mapping, Sequence

import h5py
import numpy as np

from pipeline.calibration.readers.pickle_values import read_values
from pipeline.capture.keypoint_files.deeplabcut import columns_of
from pipeline.capture.keypoint_files.hdf5.nodes import attribute, dataset, names_in, node, text, texts, values
from pipeline.capture.keypoint_files.hdf5.tracks import Tracks
from pipeline.capture.keypoint_files.people import KeypointsError, check_frames, frame_number, number_in_name
from pipeline.core.parsing import UnreadableError

_LEVELS: Mapping[int, tuple[str, ...]] = {
    3: ("scorer", "bodyparts", "coords"),
    4: ("scorer", "individuals", "bodyparts", "coords"),
}
_MAX_LEVELS, _MAX_BLOCKS = 4, 100
_KEY = "df_with_missing"


def table_of(file: h5py.File) -> h5py.Group | None:
    """Group of pandas' table; ``None`` without one. DeepLabCut's own name goes first."""
    groups = {name: found for name in names_in(file) if isinstance(found := node(file, name), h5py.Group)}
    tables = {name: group for name, group in groups.items() if text(attribute(group, "pandas_type")) is not None}
    if len(tables) > 1 and _KEY not in tables:
        raise KeypointsError(f"The HDF5 file has several tables: {', '.join(list(tables)[:3])}. Keep one of them.")
    return tables.get(_KEY, next(iter(tables.values()), None))


def read(group: h5py.Group) -> Tracks:
    """Read a table: its points that are joints, by frames.

    Raises ``KeypointsError`` if the table can't be used, ``UnreadableError`` if it is damaged.
    """
    is_table = text(attribute(group, "pandas_type")) == "frame_table"
    rows, labels, numbers = _of_table(group) if is_table else _of_fixed(group)
    check_frames(len(rows))
    if numbers.shape != (len(rows), len(labels)):
        raise UnreadableError
    columns = columns_of(_headers(labels))
    frames = [_frame_of(row) for row in rows]
    points = numbers[:, columns.number]
    points[:, columns.number[..., 2] < 0, 2] = 1.0
    return Tracks("DeepLabCut", columns.layout, frames, points)


def _headers(labels: Sequence[Sequence[str]]) -> Mapping[str, list[str]]:
    """Rows of headers, as in the CSV, of the labels of each column."""
    levels = {len(of_column) for of_column in labels}
    names = _LEVELS.get(max(levels, default=0), ())
    if len(levels) != 1 or not names:
        raise KeypointsError("The columns of the table must have the levels scorer, individuals, bodyparts, coords.")
    return {name: [of_column[k] for of_column in labels] for k, name in enumerate(names)}


def _frame_of(row: int | str) -> int:
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
