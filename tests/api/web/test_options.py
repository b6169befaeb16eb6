"""Choices of a job: the spec, the options, the command line and the page agree with ``options.config``."""

import re

import pytest
from pydantic import ValidationError

from api.cli.main import load
from pipeline.core.options.choices import declared_choices
from pipeline.core.options.config import CHOICES, ReconstructionConfig
from tests.api.conftest import Live
from website.options_page import document
from worker.store.spec import JobSpec


def test_options_describe_every_choice_of_job(live: Live) -> None:
    listed = {one["name"]: one for one in live.client.get("/v1/options").json()["choices"]}
    properties = live.client.get("/openapi.json").json()["components"]["schemas"]["JobSpec"]["properties"]
    assert list(listed) == [
        name
        for name in properties
        if name not in {"apply_edits", "callback_url", "character", "keep_videos", "priority"}
    ]
    for name in (
        "method",
        "profile",
        "joints",
        "detector",
        "smoothing",
        "feet",
        "joint_centers",
        "refine_calibration",
        "preset",
    ):
        # The networks of users are texts of a pattern beside the names.
        (names,) = [one["enum"] for one in properties[name].get("anyOf", [properties[name]]) if "enum" in one]
        assert [value["name"] for value in listed[name]["values"]] == names
        assert listed[name]["default"] == properties[name]["default"]
    assert [value["name"] for value in listed["exports"]["values"]] == properties["exports"]["items"]["enum"]
    assert listed["exports"]["default"] == properties["exports"]["default"] == ["bvh"]
    cutoff = listed["cutoff_hz"]
    assert (cutoff["default"], cutoff["exclusive_minimum"], cutoff["maximum"]) == (6.0, 0.0, 1000.0)
    assert (listed["output_rate_hz"]["minimum"], listed["output_rate_hz"]["maximum"]) == (1.0, 240.0)
    assert [one["name"] for one in listed["people"]["values"]] == ["auto"]
    assert listed["frame_range"]["unset"] == "all frames"


def test_each_purpose_sets_same_choices_to_allowed_values(live: Live) -> None:
    purposes = live.client.get("/v1/options").json()["purposes"]
    assert len({purpose["name"] for purpose in purposes}) == len(purposes) > 1
    for purpose in purposes:
        assert JobSpec.model_validate(purpose["spec"])
        assert purpose["spec"].keys() == {"exports", "preset"}
    first = purposes[0]["spec"]
    assert first == {"exports": list(CHOICES["exports"].default), "preset": CHOICES["preset"].default}


@pytest.mark.parametrize(
    "wrong",
    [
        {"method": "guessing"},
        {"cutoff_hz": 0.0},
        {"cutoff_hz": "6"},
        {"cutoff_hz": 1000.5},
        {"frame_range": [-1, 5]},
        {"frame_range": [1]},
        {"output_rate_hz": 240.5},
        {"people": 0},
        {"people": True},
        {"people": "many"},
        {"exports": ["bvh", "bvh"]},
        {"exports": ["obj"]},
    ],
    ids=str,
)
def test_specs_keep_to_declared_limits(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        JobSpec.model_validate(wrong)


def test_specs_take_what_is_declared() -> None:
    assert JobSpec().model_dump(exclude={"apply_edits", "callback_url", "character", "keep_videos", "priority"}) == {
        name: one.default for name, one in CHOICES.items()
    }
    spec = JobSpec.model_validate({"people": 2.0, "frame_range": [0, 5], "output_rate_hz": 1})
    assert (spec.people, spec.frame_range, spec.output_rate_hz) == (2, (0, 5), 1.0)


def test_reconstruct_has_option_for_every_choice() -> None:
    options = {option for parameter in load("reconstruct").params for option in parameter.opts}
    choices = (*CHOICES.values(), *declared_choices(ReconstructionConfig))
    assert {f"--{choice.option}" for choice in choices} <= options


def test_page_describes_every_option_and_value() -> None:
    page = document()
    for choice in declared_choices(ReconstructionConfig):
        field = f"[](){{ #{choice.name} }}`{choice.name}` | " if choice.name in CHOICES else ""
        assert f"\n| {field}`--{choice.option}` | {choice.about.sentence} | " in page
    for choice in CHOICES.values():
        if choice.kind in {"one", "several"}:
            section = page.partition(f"\n## Values of `{choice.name}`\n")[2].partition("\n## ")[0]
            assert re.findall(r"^\| `(.+?)` \| (.+?)(?:\. .*)? \|$", section, re.MULTILINE) == [
                (name, value.label) for name, value in choice.values.items()
            ]
    assert re.search(
        r"\n\| .*`cutoff_hz` \| `--cutoff` \| .+ \| a number, more than 0 and at most 1000 \| 6 \|\n", page
    )
