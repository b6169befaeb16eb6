"""Progress of the warm-up: functions of Multicap are counted, those of numba are not."""

from types import SimpleNamespace

import numba
from numba.core import event

from pipeline.geometry.kernels import triangulate_all
from pipeline.run.warm_up import _counted


def end_compilation(function: object) -> None:
    """Broadcast numba's event for the end of a function's compilation."""
    data = {"dispatcher": SimpleNamespace(py_func=function)}
    event.end_event("numba:compile", data)  # type: ignore[no-untyped-call]


def test_compiled_functions_of_all_packages_are_counted() -> None:
    kernel = getattr(triangulate_all, "py_func")  # noqa: B009 - numba's attribute, unknown to type checkers
    counts: list[int] = []
    with _counted(counts.append):
        end_compilation(kernel)
        end_compilation(numba.njit)
        end_compilation(kernel)
    assert counts == [1, 2]
