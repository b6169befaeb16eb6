"""The notebook of the documentation runs from its first cell to its last."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("xarray")
mpl = pytest.importorskip("matplotlib")
plt = pytest.importorskip("matplotlib.pyplot")

NOTEBOOK = Path(__file__).parents[1] / "docs" / "start" / "notebook.ipynb"


def test_cells_run_and_find_the_walker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    names: dict[str, Any] = {}
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    for cell in cells:
        assert not cell.get("outputs")
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # noqa: S102 - our own
    plt.close("all")
    (track,) = names["take"].tracks
    knee = names["take"].joints.index("left_knee")
    np.testing.assert_allclose(track.xyz_m[30, knee], names["points_m"][30, 9], atol=0.02)
    assert {"joints.parquet", "take.nc"} <= {path.name for path in tmp_path.iterdir()}
