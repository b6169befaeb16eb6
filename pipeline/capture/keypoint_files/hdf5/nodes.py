"""Groups, datasets and attributes of an untrusted HDF5 file: nothing outside the file is opened, sizes come first.

A file may name other files (external links, virtual datasets, external storage), contain itself, and unpack to far more
than its size. Only hard links are followed, one name at a time; only datasets within the file are read, after a look at
their sizes; only filters that come with HDF5 are used.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pipeline.capture.keypoint_files.people import KeypointsError

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
        raise KeypointsError("Names in the HDF5 file are no texts.")
    return names
