"""Command line for programs: exit codes, one JSON object on stdout, every problem at once."""

import contextlib
import importlib.metadata
import json
import os
import sqlite3
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import typer
from filelock import FileLock
from typer.testing import CliRunner

from api.cli.commands import keys
from api.cli.commands.reconstruct import print_summary
from api.cli.console import print_table, reporting, shows_help
from api.cli.main import COMMANDS, app
from pipeline.calibration.program_files import PROGRAM_FORMATS
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.core.problems.finding_codes import NOBODY_FOUND
from pipeline.detection import models
from pipeline.export.results import write_results
from pipeline.validation.simulation.scenes import SCENES, find_scene, record
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_video
from tests.pipeline.simulations import write_simulation
from tests.small_disk import fill, small_disk
from worker.store.files.disk import DiskSpace
from worker.store.model.rights import Key, Scope

runner = CliRunner()


def test_bad_input_lists_all_problems_as_json(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("no video")
    (tmp_path / "c.json").write_text('{"schema_version": 1, "cameras": [{"name": "a"}]}')
    result = runner.invoke(
        app,
        ["reconstruct", f"--videos={tmp_path}", f"--calibration={tmp_path / 'c.json'}", f"--out={tmp_path}", "--json"],
    )
    assert result.exit_code == 2
    problems = json.loads(result.stdout)["problems"]
    found = {(problem["code"], problem["camera"] or problem["file"], problem["field"]) for problem in problems}
    assert {
        ("too_few_videos", None, None),
        ("video_unreadable", "a.mp4", None),
        ("invalid_matrix", "a", "matrix"),
        ("invalid_rotation", "a", "rotation"),
        ("invalid_size", "a", "size"),
    } <= found
    assert str(tmp_path) not in result.stdout


def test_bad_input_lists_problems_line_for_person(tmp_path: Path) -> None:
    result = runner.invoke(
        app, ["reconstruct", f"--videos={tmp_path}", f"--calibration={tmp_path / 'none.toml'}", f"--out={tmp_path}"]
    )
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "There are no videos" in result.stderr
    assert "The calibration file does not exist" in result.stderr
    assert "Traceback" not in result.stderr


HELP_OF_ALL = """
import contextlib, io, sys
sys.argv = ["multicap", "--help"]
from api.cli.main import COMMANDS, app, load
words = [(name, each) for name in COMMANDS for each in getattr(load(name), "commands", ())]
for each in [(), *((name,) for name in COMMANDS), *words]:
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        app([*each, "--help"], standalone_mode=False)
    assert "Usage: multicap" in shown.getvalue(), each
    print(*each, ":", *{name.partition(".")[0] for name in sys.modules})
"""


def test_help_of_every_command_loads_no_science() -> None:
    """Libraries of a command are loaded when it runs."""
    command = [sys.executable, "-P", "-c", HELP_OF_ALL]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "numba", "jaxtyping", "cv2", "av", "onnxruntime", "sqlalchemy", "fastapi", "httpx2"}
    lines = (line.split(":") for line in result.stdout.splitlines())
    loaded = {words: heavy & set(names.split()) for words, names in lines}
    assert len(loaded) > 50
    assert not any(loaded.values()), loaded


@pytest.mark.parametrize(
    ("words", "is_help"),
    [
        ("multicap --help", True),
        ("multicap calibrate board --videos a b --help", True),
        ("multicap reconstruct --out --help", False),
        ("multicap reconstruct --out results -- --help", False),
        ("multicap reconstruct", False),
    ],
)
def test_help_is_told_by_the_last_word(words: str, is_help: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", words.split())
    assert shows_help() == is_help


def test_completion_in_shell_loads_no_science() -> None:
    words = {"_MULTICAP_COMPLETE": "complete_bash", "COMP_WORDS": "multicap simulate --se", "COMP_CWORD": "2"}
    code = f"import os, sys; os.environ |= {words}; from api.cli.main import app\n"
    code += "try: app(prog_name='multicap')\nexcept SystemExit: print(*sys.modules)"
    command = [sys.executable, "-P", "-c", code]
    completed, loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert completed == "--seed"
    assert not {"numpy", "scipy", "numba"} & set(loaded.split())


def test_names_in_help_are_complete() -> None:
    """The help has them without the modules that they name."""
    shown = " ".join(runner.invoke(app, ["simulate", "--help"], env={"COLUMNS": "500"}).stdout.split())
    assert f"One of {', '.join(SCENES)}." in shown
    shown = " ".join(runner.invoke(app, ["calibration", "convert", "--help"], env={"COLUMNS": "500"}).stdout.split())
    assert f"Format: {', '.join(PROGRAM_FORMATS)}." in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_its_help(name: str) -> None:
    result = runner.invoke(app, [name, "--help"])
    assert result.exit_code == 0
    assert f"multicap {name}" in result.stdout


def test_version() -> None:
    assert runner.invoke(app, ["--version"]).stdout == f"multicap {importlib.metadata.version('multicap')}\n"


def test_videos_can_be_named_one_by_one(tmp_path: Path) -> None:
    """The shell turns ``--videos *.mp4`` into one value and loose arguments; the option may be left out."""
    arguments = [str(tmp_path / name) for name in ("a.mp4", "b.mp4", "b.mov")]
    result = runner.invoke(app, ["reconstruct", "--calibration=c.toml", "--out=out", "--json", "--videos", *arguments])
    assert result.exit_code == 2
    codes = [(problem["code"], problem["file"]) for problem in json.loads(result.stdout)["problems"]]
    assert [file for code, file in codes if code == "video_missing"] == ["a.mp4", "b.mp4", "b.mov"]
    assert ("duplicate_video", "b") in codes
    loose = runner.invoke(app, ["reconstruct", "--calibration=c.toml", "--out=out", "--json", *arguments])
    assert loose.stdout == result.stdout
    both = ["reconstruct", "--calibration=c.toml", "--out=out", "--json", "--keypoints=points", *arguments]
    (problem,) = json.loads(runner.invoke(app, both).stdout)["problems"]
    assert problem["message"] == "A capture has either videos or keypoints."


def test_all_wrong_options_are_reported_at_once() -> None:
    wrong = ["--profile=slow", "--frames=5", "--units=feet", "--up=w", "--clock=sun", "--timestamps=t.csv"]
    result = runner.invoke(
        app, ["reconstruct", "--calibration=c.toml", "--out=out", "--json", *wrong, "--videos=a.mp4"]
    )
    problems = json.loads(result.stdout)["problems"]
    assert [(problem["code"], problem["field"]) for problem in problems] == [
        ("frame_range", "frame_range"),
        ("value_not_allowed", "profile"),
        ("unknown_units", "units"),
        ("unknown_clock", "clock"),
        ("unknown_axis", "up"),
        ("sources", None),
    ]


@pytest.mark.parametrize(
    ("offsets", "found"),
    [
        (["a=1e9", "b=nan"], [("offset_range", "a"), ("offset_range", "b")]),
        (["a=-86400", "b=-86400", "c=86400", "d=86400"], [("session_too_long", "c")]),
        (["a=60"], [("no_overlap", "a")]),
    ],
)
def test_offsets_that_make_no_session(tmp_path: Path, offsets: list[str], found: list[tuple[str, str]]) -> None:
    videos = [str(write_video(tmp_path / f"{name}.mp4", 5)) for name in "abcd"]
    rig = calibration(tmp_path / "rig.json", list("abcd"))
    arguments = ["reconstruct", f"--calibration={rig}", f"--out={tmp_path / 'out'}", "--json", "--videos", *videos]
    result = runner.invoke(app, [*arguments, *(f"--offset={offset}" for offset in offsets)])
    assert result.exit_code == 2
    problems = json.loads(result.stdout)["problems"]
    assert [(problem["code"], problem["camera"]) for problem in problems] == found
    assert all(problem["field"] == "offset_s" and problem["hint"] for problem in problems)


@pytest.mark.slow
def test_cameras_and_rates_are_stated_by_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files of one name in folders of their cameras, the second in slow motion, and one of its camera's name."""
    monkeypatch.setattr("api.cli.commands.check._as_declared", lambda *given: ())  # nobody is in the videos
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
    clip = write_video(tmp_path / "one" / "GX010001.mp4", 5)
    slow = write_video(tmp_path / "two" / "GX010007.mp4", 20)
    third = write_video(tmp_path / "take_c.mp4", 5)
    rig = calibration(tmp_path / "rig.json", ["a", "b", "c"])
    arguments = ["check", f"--calibration={rig}", "--json", f"--videos=b={slow}", f"--videos={third}"]

    def codes(*more: str) -> set[str]:
        result = runner.invoke(app, [*arguments, *more])
        return {finding["code"] for finding in json.loads(result.stdout)["findings"]}

    assert "camera_left_out" in codes()
    assert codes(f"--videos=a={clip}") & {"slow_motion", "camera_left_out"} == {"slow_motion"}
    assert not codes(f"--videos=a={clip}", "--rate=b=100") & {"slow_motion", "camera_left_out"}
    assert codes(f"--videos=a={clip}", "--rate=b=fast") == {"parameter_unreadable"}
    assert "recording_camera_unknown" in codes(f"--videos=d={clip}")


def test_output_rate_with_too_many_frames_is_refused(tmp_path: Path) -> None:
    write_simulation(record(replace(find_scene("unsynchronised"), duration_s=0.5), seed=4, num_views=2), tmp_path)
    for folder in (tmp_path / "keypoints").iterdir():
        (folder / "frame_900000_keypoints.json").write_text('{"people": []}')
    session = [f"--keypoints={tmp_path / 'keypoints'}", f"--calibration={tmp_path / 'calibration.json'}"]
    arguments = ["reconstruct", *session, f"--out={tmp_path / 'out'}", "--json"]
    result = runner.invoke(app, [*arguments, "--output-rate=60", "--frame-rate=25"])
    assert result.exit_code == 2
    assert [one["code"] for one in json.loads(result.stdout)["problems"]] == ["too_many_frames"]
    result = runner.invoke(app, [*arguments, "--frame-rate=1"])
    assert result.exit_code == 2
    assert {one["code"] for one in json.loads(result.stdout)["problems"]} == {"session_too_long"}


def test_unknown_method_or_detector_is_refused(tmp_path: Path) -> None:
    arguments = ["reconstruct", f"--videos={tmp_path}", "--calibration=c.toml", f"--out={tmp_path}", "--json"]
    result = runner.invoke(app, [*arguments, "--method=guessing"])
    assert result.exit_code == 2
    assert json.loads(result.stdout)["problems"][0]["code"] == "value_not_allowed"


def test_tracker_parameters_not_numbers_are_refused(tmp_path: Path) -> None:
    arguments = [f"--videos={tmp_path}", f"--calibration={tmp_path}", f"--out={tmp_path}", "--json"]
    result = runner.invoke(app, ["reconstruct", *arguments, "--tracking=alpha_3d_m=far", "--tracking=0.2"])
    assert result.exit_code == 2
    codes = [problem["code"] for problem in json.loads(result.stdout)["problems"]]
    assert codes == ["parameter_unreadable"] * 2


@pytest.mark.parametrize(
    ("options", "codes"),
    [
        (["--clustering=tau2=high", "--clustering=0.2"], ["parameter_unreadable"] * 2),
        (["--tracking=alpha_3d_m=0.2", "--method=clustering"], ["unknown_parameter"]),
        (["--clustering=tau2=0.2"], ["unknown_parameter"]),
        (
            ["--clustering=tau9=0.2", "--clustering=tau3=-1", "--method=clustering"],
            ["unknown_parameter", "parameter_range"],
        ),
    ],
)
def test_parameters_of_clustering_that_can_not_be_are_refused(
    tmp_path: Path, options: list[str], codes: list[str]
) -> None:
    write_simulation(record(replace(find_scene("room"), duration_s=0.2), 0, 2), tmp_path)
    session = [
        f"--keypoints={tmp_path / 'keypoints'}",
        f"--calibration={tmp_path / 'calibration.json'}",
        "--frame-rate=25",
    ]
    arguments = ["reconstruct", *session, f"--out={tmp_path / 'out'}", "--json", *options]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert [problem["code"] for problem in json.loads(result.stdout)["problems"]] == codes
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (["--evidence=eyes"], "unknown_evidence"),
        (["--evidence=fields"], "unknown_evidence"),
        (["--ablation"], "no_ablation"),
        (["--ablation", "--method=clustering", "--evidence=bodies"], "no_ablation"),
        (["--views=4,many"], "wrong_number_of_views"),
        (["--joints=face"], "unknown_joints"),
    ],
)
def test_evaluations_that_make_no_sense_are_refused(options: list[str], code: str) -> None:
    result = runner.invoke(app, ["evaluate", "simulated", "--scene=room", "--json", *options])
    assert result.exit_code == 2
    assert [problem["code"] for problem in json.loads(result.stdout)["problems"]] == [code]


def test_wrong_usage_exits_with_2() -> None:
    assert runner.invoke(app, ["reconstruct"]).exit_code == 2
    assert runner.invoke(app, ["fly"]).exit_code == 2


def test_models_list_has_keys_that_others_rely_on() -> None:
    listed = json.loads(runner.invoke(app, ["models", "list", "--json"]).stdout)["models"]
    assert {"name", "installed", "licence", "sha256"} <= set(listed[0])
    assert [one["name"] for one in listed] == [one.name for one in models.status()]


def test_model_unknown_is_refused(tmp_path: Path) -> None:
    result = runner.invoke(app, ["models", "install", "yolo"])
    assert result.exit_code in {1, 2}
    assert "movenet-multipose" in result.stderr


@pytest.mark.parametrize(
    "command", ["reconstruct", "demo", "audit", "evaluate", "benchmark", "keys", "models", "samples", "webhooks"]
)
def test_every_command_says_what_it_does(command: str) -> None:
    result = runner.invoke(app, [command, "--help"])
    assert result.exit_code == 0
    assert len(result.stdout) > 100


def test_export_unknown_format_is_named_with_known_formats(tmp_path: Path) -> None:
    folder = str(tmp_path)
    arguments = ["reconstruct", "--videos", folder, "--calibration", folder, "--out", folder, "--exports", "bvh,obj"]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert "exports[1]" in result.stderr
    assert "trc" in result.stderr


def test_take_without_people_leaves_valid_files(tmp_path: Path) -> None:
    nobody = Reconstruction((), COCO_17, Timebase(0.0, 25.0, 40), (), (), Animation((), (), None))
    paths = write_results(nobody, tmp_path / "new" / "results")
    assert sorted(path.name for path in paths) == ["metrics.json", "skeletons.json"]
    assert sorted(path.name for path in paths[0].parent.iterdir()) == ["metrics.json", "skeletons.json"]
    assert json.loads((tmp_path / "new/results/skeletons.json").read_text())["tracks"] == []


def test_keys_are_made_listed_and_revoked(tmp_path: Path) -> None:
    data = ["--data", str(tmp_path / "service")]
    made = runner.invoke(app, ["keys", "create", "portal", "--tenant", "studio", "--days", "7", "--json", *data])
    key = json.loads(made.stdout)
    assert key["key"].startswith("mc_")
    assert (key["tenant"], key["scopes"], key["revoked_at"]) == ("studio", ["read", "write"], None)
    days = datetime.fromisoformat(key["expires_at"]) - datetime.fromisoformat(key["created_at"])
    assert days.total_seconds() == pytest.approx(7 * 86_400, abs=1)
    secret = runner.invoke(app, ["keys", "create", "monitoring", "--scope", "admin", *data]).stdout.strip()
    assert secret.startswith("mc_")
    assert runner.invoke(app, ["keys", "revoke", key["id"], *data]).exit_code == 0
    listed = runner.invoke(app, ["keys", "list", "--json", *data])
    first, second = json.loads(listed.stdout)["keys"]
    assert (first["name"], first["revoked_at"] is None) == ("portal", False)
    assert (second["name"], second["tenant"], second["scopes"]) == ("monitoring", "default", ["admin"])
    assert "mc_" not in listed.stdout
    events = json.loads(runner.invoke(app, ["audit", "--tenant", "studio", "--json", *data]).stdout)["events"]
    assert [(event["act"], event["subject"]) for event in events] == [
        ("key-revoked", key["id"]),
        ("key-created", key["id"]),
    ]
    assert key["id"] in runner.invoke(app, ["audit", *data]).stdout


def test_webhook_secrets_are_made_and_what_is_left_is_listed(tmp_path: Path) -> None:
    data = ["--data", str(tmp_path / "service")]
    made = json.loads(runner.invoke(app, ["webhooks", "rotate", "--tenant", "studio", "--json", *data]).stdout)
    assert made["tenant"] == "studio"
    assert made["secret"].startswith("whsec_")
    assert runner.invoke(app, ["webhooks", "rotate", *data]).stdout.startswith("whsec_")
    assert json.loads(runner.invoke(app, ["webhooks", "list", "--json", *data]).stdout) == {"deliveries": []}
    assert runner.invoke(app, ["webhooks", "list", *data]).exit_code == 0
    refused = runner.invoke(app, ["webhooks", "rotate", "--tenant", "x" * 65, *data])
    assert (refused.exit_code, "1 to 64" in refused.stderr) == (2, True)
    events = json.loads(runner.invoke(app, ["audit", "--tenant", "studio", "--json", *data]).stdout)["events"]
    assert [event["act"] for event in events] == ["webhook-secret-made"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["revoke", "nobody"], "multicap keys list"),
        (["create", ""], "1 to 200 characters"),
        (["create", "x", "--tenant", "t" * 65], "1 to 64"),
        (["create", "x", "--scope", "root"], "read"),
        (["create", "x", "--days", "0"], "--days"),
    ],
)
def test_keys_that_can_not_be(tmp_path: Path, arguments: list[str], words: str) -> None:
    result = runner.invoke(app, ["keys", *arguments, "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr


def test_service_beyond_this_machine_requires_keys(tmp_path: Path) -> None:
    result = runner.invoke(app, ["serve", "--host", "0.0.0.0", "--port", "0", "--data", str(tmp_path)])  # noqa: S104
    if "multicap models install" in result.stderr:
        pytest.skip("the default detector is not installed")
    assert result.exit_code == 2
    assert "multicap keys create" in result.stderr


@pytest.mark.parametrize("url", ["postgresql://nobody:secret@127.0.0.1:1/multicap", "no url", "oracle://x"])
def test_database_away_is_no_stack_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setenv("MULTICAP_DATABASE_URL", url)
    result = runner.invoke(app, ["keys", "list", "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert "MULTICAP_DATABASE_URL" in result.stderr
    assert "secret" not in result.stderr
    assert "Traceback" not in result.stderr


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terminal that is too narrow for any table."""
    monkeypatch.setenv("COLUMNS", "20")


@pytest.mark.usefixtures("narrow")
@pytest.mark.parametrize("as_json", [False, True])
def test_too_little_memory_is_told_without_stack_trace(as_json: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as left, reporting(as_json):
        bytearray(2**62)
    assert left.value.exit_code == 1
    printed = capsys.readouterr()
    said = json.loads(printed.out)["problems"][0]["message"] if as_json else printed.err
    assert "There is not enough memory for this." in said


def test_table_row_is_one_line_with_whole_cells(capsys: pytest.CaptureFixture[str]) -> None:
    long = "x" * 300
    print_table(("name", "what it is"), [("a", long), ("\u6771\u4eac", ""), ("b[red]c[/]", ":smile:")])
    assert capsys.readouterr().out.splitlines() == [
        "name        what it is",
        f"a           {long}",
        "\u6771\u4eac        -",
        "b[red]c[/]  :smile:",
    ]


def test_control_characters_are_shown_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(["to"], [["https://a\x1b[2J\nb\u202e"]])
    assert capsys.readouterr().out == "to\nhttps://a\\x1b[2J\\nb\\u202e\n"


@pytest.mark.usefixtures("narrow")
def test_ids_and_names_are_never_shortened_in_lists(tmp_path: Path) -> None:
    data = ["--data", str(tmp_path)]
    key = json.loads(runner.invoke(app, ["keys", "create", "a name of some length", "--json", *data]).stdout)
    listed = runner.invoke(app, ["keys", "list", *data])
    header, row = listed.stdout.splitlines()
    assert header.split() == ["id", "tenant", "name", "scopes", "until"]
    assert row == f"{key['id']}  default  a name of some length  read write  no end"
    assert listed.stderr == ""
    (row,) = runner.invoke(app, ["audit", *data]).stdout.splitlines()[1:]
    assert row.endswith(f"  default  -    key-created  {key['id']}")
    rows = runner.invoke(app, ["models", "list"]).stdout.splitlines()[1:]
    assert [row.split()[0::3] for row in rows] == [[one.name, one.sha256] for one in models.status()]
    assert runner.invoke(app, ["webhooks", "list", *data]).stdout.split() == [
        "job",
        "tenant",
        "to",
        "tries",
        "next",
        "problem",
    ]
    runner.invoke(app, ["keys", "revoke", key["id"], *data])
    (row,) = runner.invoke(app, ["keys", "list", *data]).stdout.splitlines()[1:]
    assert f"  revoked {datetime.now(UTC):%Y-%m-%d}" in row
    assert row.endswith(" UTC")


def test_until_when_key_is_valid() -> None:
    now = datetime(2026, 12, 1, 10, 0, 30, tzinfo=UTC)

    def until(expires_at: datetime | None, revoked_at: datetime | None = None) -> str:
        return keys._until(Key("i", "t", "n", frozenset({Scope.READ}), now, expires_at, revoked_at), now)

    assert until(None) == "no end"
    assert until(now + timedelta(days=1)) == "2026-12-02 10:00 UTC"
    assert until(now - timedelta(days=1)) == "expired 2026-11-30 10:00 UTC"
    assert until(now) == "expired 2026-12-01 10:00 UTC"
    assert until(now + timedelta(days=1), now) == "revoked 2026-12-01 10:00 UTC"


@pytest.mark.usefixtures("narrow")
def test_take_summary_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nobody = Reconstruction((), COCO_17, Timebase(0.0, 25.0, 40), (), (), Animation((), (), None))
    write_results(nobody, tmp_path)
    print_summary(json.loads((tmp_path / "metrics.json").read_bytes()), {NOBODY_FOUND: "An empty room."})
    printed = capsys.readouterr()
    assert " ".join(printed.err.split()).endswith("An empty room.")
    lines = printed.out.splitlines()
    assert lines[0] == "person  frames  reprojection error  cameras a joint  coverage  stature"
    assert lines[1].startswith("40 frames at 25 Hz")
    assert lines[3].split() == ["bone", "length", "deviation", "-", "-"]


NEWER = "written by a newer version of Multicap (schema 0099). Upgrade Multicap, or restore a backup"


@pytest.mark.parametrize(
    ("command", "status"),
    [
        (["api.cli.main", "keys", "list", "--data"], 2),
        pytest.param(["api.cli.main", "keys", "create", "portal", "--data"], 2, marks=pytest.mark.slow),
        pytest.param(["api.cli.main", "audit", "--data"], 2, marks=pytest.mark.slow),
        pytest.param(["api.cli.main", "webhooks", "list", "--data"], 2, marks=pytest.mark.slow),
        pytest.param(["api.cli.main", "serve", "--port", "0", "--data"], 2, marks=pytest.mark.slow),
        pytest.param(["api"], 1, marks=pytest.mark.slow),
    ],
)
def test_database_newer_version_is_sentence(tmp_path: Path, command: list[str], status: int) -> None:
    assert runner.invoke(app, ["keys", "list", "--data", str(tmp_path)]).exit_code == 0
    with contextlib.closing(sqlite3.connect(tmp_path / "multicap.db")) as database, database:
        database.execute("UPDATE alembic_version SET version_num = '0099'")
    line = [sys.executable, "-m", *command, *([str(tmp_path)] if command[-1] == "--data" else [])]
    environment = os.environ | {"MULTICAP_DATA_DIR": str(tmp_path), "MULTICAP_PORT": "0"}
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=180, check=False)
    if "multicap models install" in done.stderr:
        pytest.skip("the default detector is not installed")
    assert done.returncode == status
    assert NEWER in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_second_api_process_is_refused_and_empties_no_spool(tmp_path: Path) -> None:
    being_received = tmp_path / "spool" / "a session" / "cam_0.mp4"
    being_received.parent.mkdir(parents=True)
    being_received.write_bytes(b"frames")
    environment = os.environ | {"MULTICAP_DATA_DIR": str(tmp_path), "MULTICAP_PORT": "0"}
    with FileLock(tmp_path / "api.lock"):
        done = subprocess.run(
            [sys.executable, "-m", "api"], env=environment, capture_output=True, text=True, timeout=180, check=False
        )
    assert done.returncode == 1
    assert done.stderr.startswith("error: Another API process runs on the folder")
    assert being_received.read_bytes() == b"frames"


def test_keys_full_disk_are_revoked_and_none_is_made(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 16) as disk:
        data = f"--data={disk / 'data'}"
        made = json.loads(runner.invoke(app, ["keys", "create", "portal", data, "--json"]).stdout)
        DiskSpace(disk / "data").set_aside()
        fill(disk / "filler")
        (disk / "data" / "reserve").rename(disk / "held back")
        refused = runner.invoke(app, ["keys", "create", "another", data])
        assert refused.exit_code == 2
        assert "is full. Free space on it" in refused.stderr
        (disk / "held back").rename(disk / "data" / "reserve")
        assert runner.invoke(app, ["keys", "revoke", made["id"], data]).exit_code == 0
        (listed,) = json.loads(runner.invoke(app, ["keys", "list", data, "--json"]).stdout)["keys"]
        assert listed["revoked_at"] is not None
