"""Rules of choices: what a session does not allow is found at once, and nothing else is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.options.config import MAX_OUTPUT_FRAMES, ReconstructionConfig
from pipeline.core.options.file_formats import Export, installed_formats
from pipeline.core.options.requirements import faults
from pipeline.core.options.rules import (
    CONFIG_CHOICES,
    config_problems,
    num_resampled,
    plain_value,
    session_problems,
    value_problems,
)

CONFIG = ReconstructionConfig(smoothing="butterworth", exports=("bvh",))
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)


def codes(config: ReconstructionConfig, num_frames: int, frame_rate_hz: float) -> dict[str | None, str]:
    return {problem.field: problem.code for problem in config_problems(config, num_frames, frame_rate_hz)}


def test_all_that_session_does_not_allow_is_found_at_once() -> None:
    config = replace(CONFIG, cutoff_hz=12.5, exports=("bvh", "c3d"), clustering={"tau2": 0.2})
    assert codes(config, 100_000, 25.0) == {"cutoff_hz": "cutoff_range", None: "unknown_parameter"}
    assert codes(replace(config, clustering={}), 100_000, 25.1) == {}


@pytest.mark.parametrize(("export", "package"), [("usd", "usd-core"), ("rerun", "rerun-sdk")])
def test_format_not_installed_is_refused_with_command(
    export: Export, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.core.options.file_formats.find_spec", lambda _: None)
    assert export not in installed_formats()
    config = replace(CONFIG, exports=("bvh", export, "glb"))
    (problem,) = config_problems(config, 100, 25.0)
    assert (problem.code, problem.field) == ("format_not_installed", "exports")
    assert package in problem.message
    assert f"multicap[{export}]" in str(problem.hint)
    assert codes(replace(config, exports=("bvh", "glb")), 100, 25.0) == {}


def test_opensim_needs_its_package_and_its_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("pipeline.core.options.file_formats.find_spec", lambda _: object())
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    assert "osim" not in installed_formats()
    (problem,) = config_problems(replace(CONFIG, exports=("bvh", "osim")), 100, 25.0)
    assert (problem.code, problem.field) == ("format_not_installed", "exports")
    assert "pip install multicap[opensim], then multicap opensim install" in str(problem.hint)
    (tmp_path / "opensim").mkdir()
    (tmp_path / "opensim" / "generic.osim").touch()
    assert "osim" in installed_formats()


def test_frames_at_another_rate_are_bounded() -> None:
    """A session of three hours at 24 Hz, which has 2.6 million frames at 240 Hz."""
    config = replace(CONFIG, output_rate_hz=240.0)
    assert codes(config, 3 * 3600 * 24, 24.0) == {"output_rate_hz": "too_many_frames"}
    assert codes(config, (MAX_OUTPUT_FRAMES - 1) // 10 + 1, 24.0) == {}
    assert codes(config, (MAX_OUTPUT_FRAMES - 1) // 10 + 2, 24.0) == {"output_rate_hz": "too_many_frames"}
    assert codes(replace(config, frame_range=(0, 1000)), 3 * 3600 * 24, 24.0) == {}


@given(frames=st.tuples(st.integers(0, 100), st.integers(0, 100)), num_frames=st.integers(1, 100))
def test_frames_are_those_of_session(frames: tuple[int, int], num_frames: int) -> None:
    found = [problem.code for problem in session_problems(replace(CONFIG, frame_range=frames), num_frames, 25.0)]
    assert found == ([] if range(num_frames)[slice(*frames)] == range(*frames) != range(0) else ["frame_range"])


@given(st.integers(1, 10**6), st.floats(1.0, 240.0), st.floats(1.0, 240.0))
def test_last_frame_at_another_rate_is_not_later(num_frames: int, rate_hz: float, new_hz: float) -> None:
    num_new = num_resampled(num_frames, rate_hz, new_hz)
    last_s = (num_frames - 1) / rate_hz
    assert (num_new - 1) / new_hz <= last_s + 1e-6 / rate_hz
    assert num_new / new_hz > last_s - 1e-6 / rate_hz


@pytest.mark.parametrize("name", CONFIG_CHOICES)
def test_defaults_keep_rules(name: str) -> None:
    default = CONFIG_CHOICES[name].default
    assert not list(value_problems({name: default}))
    assert plain_value(CONFIG_CHOICES[name], default) == default


@given(st.sampled_from(list(CONFIG_CHOICES)), JSON)
def test_each_value_is_taken_or_refused_with_sentence(name: str, value: Any) -> None:
    """A value that is taken stays the same as JSON; a sentence about one that is not names the field."""
    choice, problems = CONFIG_CHOICES[name], list(value_problems({name: value}))
    assert all(problem.message.startswith(name) and problem.field for problem in problems)
    if not problems:
        taken = json.loads(json.dumps(plain_value(choice, value)))
        assert taken == value
        assert not list(faults(choice.schema, taken))
