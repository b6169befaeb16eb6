"""The extension for Blender as a newcomer uses it: the sample capture sent, followed, imported, and put on a character.

With ``MULTICAP_PICTURES`` the scenes are rendered: ``blender-people.jpg`` and ``blender-character.jpg`` of the page
docs/start/blender.md.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.api.blender.test_in_blender import blender, extension
from tests.e2e.serving import Served

__all__ = ["blender", "extension"]
pytestmark = [pytest.mark.blender, pytest.mark.xdist_group("sample")]


def test_sample_opens_in_blender(
    served: Served, sample: Sample, blender: Callable[..., list[Any]], tmp_path: Path
) -> None:
    address = str(served.client.base_url)
    folder = next(iter(sample.videos.values())).parent
    pictures = Path(os.environ["MULTICAP_PICTURES"]).absolute() if "MULTICAP_PICTURES" in os.environ else None
    rendered = [("render", {"path": str(pictures / "blender-people.jpg")})] if pictures else []
    connected, _, _, sent, imported, *_, scene = blender(
        address,
        [
            ("press", {"name": "connect"}),
            ("set_panel", {"folder": str(folder), "calibration": str(sample.calibration)}),
            ("set_panel", {"has_cameras": True}),
            ("press", {"name": "send", "seconds": 900.0}),
            ("press", {"name": "import_people"}),
            *rendered,
            ("scene", {}),
        ],
    )
    assert connected["message"] == "There are no captures yet. Send one below."
    assert sent["message"].endswith("is reconstructed: import its people."), sent
    # The sample shows three people; nothing held Blender up while files went and the job ran.
    assert imported["message"] == "Imported 3 people and 4 cameras."
    assert sent["longest_s"] < 1.0
    job = served.client.get("/v1/jobs").raise_for_status().json()["jobs"][0]
    assert scene["frames"] == [0, job["num_frames"] - 1]
    assert sorted(scene["heads"]) == ["person-1", "person-2", "person-3"]

    # A character: another person's figure, made smaller, turned, and moved aside.
    own = tmp_path / "character.glb"
    own.write_bytes(served.client.get(f"/v1/jobs/{job['id']}/results/person-2.glb").raise_for_status().content)
    rendered = [("render", {"path": str(pictures / "blender-character.jpg")})] if pictures else []
    _, _, first, _, _, put, *_, scene = blender(
        address,
        [
            ("show_people", {}),
            ("choose", {"people": [0]}),
            ("press", {"name": "import_people"}),
            ("open_armature", {"path": str(own)}),
            ("move_armature", {"place": [0.0, 0.0, 0.0], "degrees": 0.0, "size": 0.8}),
            ("press", {"name": "put_on"}),
            *rendered,
            ("scene", {}),
        ],
    )
    assert first["message"] == "Imported 1 person."
    assert "moves as person-1" in put["message"]
    person, figure = scene["heads"]["person-1"], scene["heads"]["person-2"]
    for above, below in (("LeftArm", "LeftForeArm"), ("RightUpLeg", "RightLeg")):
        ways = [np.array(heads[below]) - np.array(heads[above]) for heads in (person, figure)]
        cosines = (ways[0] * ways[1]).sum(1) / np.prod([np.linalg.norm(way, axis=1) for way in ways], axis=0)
        assert np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0).min())) < 0.2, below
    # Toes are as far above the floor as the person's, in the proportion of the legs.
    legs, toes_m = [], []
    for name in ("person-1", "person-2"):
        rest = {joint: np.array(place) for joint, place in scene["rest"][name].items()}
        legs.append(
            sum(np.linalg.norm(rest[f"Left{a}"] - rest[f"Left{b}"]) for a, b in (("UpLeg", "Leg"), ("Leg", "Foot")))
        )
        ends = [np.array(scene["heads"][name][f"{side}FootEnd"])[:, 2] for side in ("Left", "Right")]
        toes_m.append(np.median(np.minimum(*ends)))
    assert toes_m[1] == pytest.approx(legs[1] / legs[0] * toes_m[0], abs=0.05)
