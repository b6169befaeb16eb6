"""Lists of names in messages of checks."""

from collections.abc import Sequence

_MAX_NAMES = 10


def first_names(names: Sequence[str]) -> str:
    """List the first ten names and the number of the others.

    >>> first_names([f"person-{k}" for k in range(1, 4)])
    'person-1, person-2, person-3'
    >>> first_names([f"cam{k}" for k in range(12)])
    'cam0, cam1, cam2, cam3, cam4, cam5, cam6, cam7, cam8, cam9 and 2 more'
    """
    more = len(names) - _MAX_NAMES
    listed = ", ".join(names[:_MAX_NAMES])
    return f"{listed} and {more} more" if more > 0 else listed
