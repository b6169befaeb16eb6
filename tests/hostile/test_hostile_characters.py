"""Damaged characters in a service with the real check: taken or refused, never 5xx, and nothing is left of them."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.web.settings import MIB, Settings
from pipeline.export.character.gltf_reader import decode_character
from tests.api.conftest import NO_BROKER, running
from tests.pipeline.export.character.characters import parts
from tests.pipeline.export.character.fbx.fbx_characters import fbx_of, mutated_fbx
from tests.pipeline.export.character.test_check_character import MIXAMO, mutated

# Files of GLB, and of FBX
NUM_FILES, NUM_SENDERS = 200, 3


@pytest.mark.hostile
def test_damaged_characters_are_answered(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    document, binary = parts(MIXAMO)
    contents = [("robot.glb", mutated(number, document, binary, rng)) for number in range(NUM_FILES)]
    fbx = fbx_of(decode_character("robot.glb", MIXAMO))
    contents += [("robot.fbx", mutated_fbx(fbx, number, rng)) for number in range(NUM_FILES)]
    # Machines of tests are busy.
    patient: dict[str, Any] = {"preflight_timeout_s": 120.0, "preflight_wait_s": 120.0}
    with running(Settings(data_dir=tmp_path, broker_url=NO_BROKER, max_character_bytes=MIB, **patient)) as live:

        def send(file: tuple[str, bytes]) -> int:
            answer = live.client.post("/v1/characters", files=[("character", file)])
            if answer.status_code == 422:
                assert all(item["code"].startswith("character_") for item in answer.json()["errors"]), answer.text
            return answer.status_code

        with ThreadPoolExecutor(NUM_SENDERS) as senders:
            statuses = Counter(senders.map(send, contents))
        assert set(statuses) == {201, 422}, statuses
        assert statuses[422] > NUM_FILES // 2
        while characters := live.client.get("/v1/characters", params={"limit": 200}).json()["characters"]:
            for character in characters:
                assert live.client.get(character["urls"]["self"]).status_code == 200
                assert live.client.delete(character["urls"]["self"]).status_code == 204
        assert live.kept() == []
