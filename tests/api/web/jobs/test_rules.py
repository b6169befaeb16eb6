"""The spec of a job, the command line and Python say the same about each wrong choice."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from typer.testing import CliRunner

from api.cli import sources
from api.cli.main import app
from api.web.jobs.queueing import SpecLimits, check_spec
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.capture.preflight_record import Preflight, PreflightTimebase
from pipeline.core.data.cameras import Timebase
from pipeline.core.errors import InputError
from pipeline.core.options.choices import Choice
from pipeline.core.options.config import CHOICES, ReconstructionConfig
from pipeline.core.options.file_formats import installed_formats
from pipeline.core.options.rules import Installed, config_problems
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation
from worker.store.spec import JobSpec

Sentences = list[tuple[str, str, str | None]]
runner = CliRunner()
FULL_DISK = SimpleNamespace(total=1 << 40, used=1 << 40, free=0)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(record(replace(find_scene("room"), duration_s=0.2), 0, 2), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)


def wrong_values(choice: Choice) -> Iterator[Any]:
    """Values that violate each rule of a choice, as far as an option can be typed so."""
    match choice.kind:
        case "one":
            yield "no-such"
        case "several":
            first = next(iter(choice.values))
            yield from (("no-such",), (first, "no-such"), (first, first))
        case "frame_range":
            yield from ((-1, 5), (5, -1), (-2, -1))
        case "number" | "whole_number":
            about, kind = choice.about, float if choice.kind == "number" else int
            bounds = (None if about.minimum is None else about.minimum - 1, about.above)
            yield from (kind(bound) for bound in bounds if bound is not None)
            yield from () if about.maximum is None else (kind(about.maximum + 1),)


def typed(choices: dict[str, Any]) -> list[str]:
    """Options of the command line for choices."""
    words = []
    for name, value in choices.items():
        choice = CHOICES[name]
        match choice.kind:
            case "flag":
                words += [f"--{choice.option}"] if value else []
            case "several":
                words.append(f"--{choice.option}={','.join(value)}")
            case "frame_range":
                words += [] if value is None else [f"--{choice.option}={value[0]}:{value[1]}"]
            case _:
                words += [] if value in {None, choice.default} else [f"--{choice.option}={value}"]
    return words


def of_command(choices: dict[str, Any], folder: Path) -> Sentences:
    arguments = ["reconstruct", "--keypoints=k", "--calibration=c", f"--out={folder / 'out'}", "--no-cache", "--json"]
    result = runner.invoke(app, [*arguments, *typed(choices)])
    assert result.exit_code == 2, result.output
    assert not (folder / "out").exists()
    return [(found["field"], found["message"], found["hint"]) for found in json.loads(result.stdout)["problems"]]


def of_python(session: KeypointSession, choices: dict[str, Any]) -> Sentences:
    config = ReconstructionConfig()
    for name, value in choices.items():  # tests check the types of arguments, which programs need not
        object.__setattr__(config, name, value)
    with pytest.raises(InputError) as refused:
        reconstruct(session, config)
    return [(str(problem.field), problem.message, problem.hint) for problem in refused.value.problems]


def of_spec(choices: dict[str, Any]) -> Sentences:
    with pytest.raises(ValidationError) as refused:
        JobSpec.model_validate_json(json.dumps(choices))
    return [(str(error["loc"][0]), error["msg"], None) for error in refused.value.errors()]


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name, choice in CHOICES.items() for value in wrong_values(choice)],
    ids=str,
)
def test_value_that_choice_may_not_have(name: str, value: Any, session: KeypointSession, tmp_path: Path) -> None:
    said = of_spec({name: value})
    assert said
    assert [(field.partition("[")[0], *rest) for field, *rest in of_python(session, {name: value})] == said
    assert [(field.partition("[")[0], *rest) for field, *rest in of_command({name: value}, tmp_path)] == said


def test_all_wrong_values_are_named_at_once(session: KeypointSession, tmp_path: Path) -> None:
    wrong = {name: values[0] for name, choice in CHOICES.items() if (values := list(wrong_values(choice)))}
    said = {message for _, message, _ in of_spec(wrong)}
    assert len(said) >= len(wrong) > 12
    assert {message for _, message, _ in of_python(session, wrong)} == said
    assert {message for _, message, _ in of_command(wrong, tmp_path)} == said


CHOSEN = st.fixed_dictionaries(
    {
        "smoothing": st.sampled_from(["butterworth", "fit"]),
        "cutoff_hz": st.floats(0.5, 100.0),
        "frame_range": st.none() | st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)),
        "output_rate_hz": st.none() | st.floats(1.0, 240.0),
        "exports": st.lists(st.sampled_from(installed_formats()), unique=True, max_size=3).map(tuple),
    }
)


@settings(max_examples=30, deadline=None)
@given(chosen=CHOSEN, num_frames=st.integers(1, 10**6), rate_hz=st.sampled_from([5.0, 25.0, 29.97, 120.0]))
def test_choices_that_do_not_suit_session(
    chosen: dict[str, Any], num_frames: int, rate_hz: float, session: KeypointSession, tmp_path_factory: Any
) -> None:
    assume(list(config_problems(ReconstructionConfig(**chosen), num_frames, rate_hz)))
    long = replace(session, timebase=Timebase(0.0, rate_hz, num_frames))
    limits = SpecLimits(Installed(), allows_private_webhooks=True, records=Mock())
    preflight = Preflight((), PreflightTimebase(0.0, rate_hz, num_frames), (range(num_frames),))
    said = [
        (str(problem.field), problem.message, problem.hint)
        for problem in check_spec(JobSpec(**chosen), preflight, limits)
    ]
    assert of_python(long, chosen) == said
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "open_keypoints", lambda *arguments, **options: long)
        # Wrong choices are said before the space of what they would ask for, however full the disk is.
        patch.setattr("api.cli.space.shutil.disk_usage", lambda folder: FULL_DISK)
        assert of_command(chosen, tmp_path_factory.mktemp("command")) == said
