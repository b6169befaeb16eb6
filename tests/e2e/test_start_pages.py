"""Code blocks of the first pages and of the README: each is run as it stands, or a table says what is tried instead.

Commands run in a folder that looks like an installed checkout to them, and against a running service. A command that no
rule of the table covers fails the tests, and so does a rule that covers no command.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import av
import pytest
import yaml

from api.cli.main import load
from pipeline.core.runtime.packages.samples import Sample
from pipeline.export.character.mapping import bone_table
from pipeline.validation.simulation.scenes import SCENES, record
from tests.e2e.serving import Served
from tests.pipeline.export.character.characters import vrm
from tests.pipeline.simulations import write_simulation

# Other tests share the service.
pytestmark = pytest.mark.xdist_group("service")

ROOT = Path(__file__).parents[2]
START = ROOT / "docs/start"
PAGES = {path.relative_to(START).with_suffix("").as_posix(): path for path in sorted(START.rglob("*.md"))}
PAGES["README"] = ROOT / "README.md"
ADDRESS = "http://127.0.0.1:8000"
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\S*)\n(?P<text>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL)
CONTAINERS = "docker/verify/containers.sh"
MULTICAP = r"\.venv/bin/multicap "
# Frames of the sample that jobs get: the commands are the same, and take a fifth of the time.
NUM_FRAMES = 20
# Pages whose commands need the whole sample: a look at people, and clocks, from a few frames would be uncertain.
WHOLE = {"own-cameras", "live"}


@dataclass(frozen=True, slots=True)
class Block:
    """Code block of a page."""

    page: str
    number: int
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """Commands of a block for the shell, without comments and continued lines."""
        lines = [line.strip() for line in re.sub(r" *\\\n *", " ", self.text).splitlines()]
        return [re.sub(r"\s+#\s.*", "", line) for line in lines if line and not line.startswith("#")]


@dataclass(frozen=True, slots=True)
class Rule:
    """Trial of the commands that a pattern matches."""

    pattern: str
    # `run`: the command itself; `recipe`: lines of the Makefile's target; `parsed`: the options are read, no more;
    # `elsewhere`: files of `stands` have the texts beside them, where the same is run
    tried: Literal["run", "recipe", "parsed", "elsewhere"]
    reason: str
    stands: tuple[tuple[str, str], ...] = ()


RULES = (
    Rule(r"mkdir -p \w+", "run", "cheap"),
    Rule(r"curl .*", "run", "the service of the tests answers"),
    Rule(MULTICAP + r"(reconstruct|check|sync) .*", "run", "the sample, whose detections are kept"),
    Rule(MULTICAP + r"keys create \w+", "run", "cheap, in a data folder of its own"),
    Rule(MULTICAP + r"live (?!.*://).*", "run", "cameras are files"),
    Rule(
        MULTICAP + r"live .*://.*",
        "parsed",
        "cameras on a network are not at hand; servers on loopback are",
        (("tests/e2e/test_live_cameras.py", "rtsp://127.0.0.1"),),
    ),
    Rule(
        MULTICAP + r"calibrate people .*",
        "parsed",
        "the sample's people do not walk about; simulated ones do, for the same command",
        (("tests/api/cli/commands/test_calibrate.py", '"calibrate", "people"'),),
    ),
    Rule(
        MULTICAP + r"calibrate board .*",
        "parsed",
        "filmed boards take a minute",
        (("tests/pipeline/calibration/board/test_filmed_board.py", "def test_"),),
    ),
    Rule(
        MULTICAP + r"serve --https",
        "parsed",
        "it runs until Ctrl-C and takes port 8000 of all addresses; the certificate is tried with phones",
        (("tests/api/cli/test_certificates.py", "own_encryption"),),
    ),
    Rule(r"make blender-extension", "recipe", "it builds a zip"),
    Rule(
        r"make demo",
        "elsewhere",
        "it installs packages, networks and the sample, and reconstructs them",
        (("Makefile", "\ndemo:  ##"), ("Makefile", "\t$(BIN)/multicap demo\n")),
    ),
    Rule(
        r"make serve",
        "elsewhere",
        "it installs packages and networks, and runs until Ctrl-C; the tests' service is the same command",
        (("Makefile", "\nserve: setup  ##"), ("Makefile", "\t$(BIN)/multicap serve\n")),
    ),
    Rule(
        r"docker compose -f docker/compose\.yml build",
        "elsewhere",
        "it builds the image, of which `make verify-containers` makes the same from the same file",
        (
            ("docker/compose.yml", "dockerfile: docker/multicap.Dockerfile"),
            (CONTAINERS, '--file "$ROOT/docker/multicap.Dockerfile"'),
        ),
    ),
    Rule(
        r"docker compose -f docker/compose\.yml up (--detach|--build)",
        "elsewhere",
        "it starts containers, which `make verify-containers` does by podman-compose",
        (
            ("docker/compose.yml", "docker compose --file docker/compose.yml up --build"),
            (CONTAINERS, "FILE=$ROOT/docker/compose.yml"),
            (CONTAINERS, "compose up --detach"),
            (CONTAINERS, "/readyz"),
        ),
    ),
    Rule(
        r"docker compose -f docker/compose\.yml down",
        "elsewhere",
        "it removes containers, which `make verify-containers` does",
        ((CONTAINERS, "compose down"),),
    ),
    Rule(
        r"docker run .* multicap:local multicap samples install",
        "elsewhere",
        "it runs the image, as `make verify-containers` does to get the sample",
        (
            ("docker/compose.yml", "image: multicap:${MULTICAP_VERSION:-local}"),
            (CONTAINERS, "multicap:1 multicap samples install"),
        ),
    ),
)


def character_bones(document: Any) -> None:
    assert "LeftShoulder" in bone_table(document)


# Checks of the contents of files, by page.
CONTENTS: Mapping[str, Callable[[Any], None]] = {"own-character": character_bones}
PARSERS: Mapping[str, Callable[[str], Any]] = {"json": json.loads, "yaml": yaml.safe_load}


def blocks_of(page: str) -> list[Block]:
    found = FENCE.finditer(PAGES[page].read_text(encoding="utf-8"))
    return [
        Block(page, number, block["language"], textwrap.dedent(block["text"])) for number, block in enumerate(found, 1)
    ]


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def rules_of(command: str) -> list[Rule]:
    return [rule for rule in RULES if re.fullmatch(rule.pattern, command)]


COMMANDS = [(block.page, command) for block in BLOCKS if block.language == "sh" for command in block.commands]
PARSED = [
    (page, line) for page, line in dict.fromkeys(COMMANDS) if any(rule.tried == "parsed" for rule in rules_of(line))
]


def test_blocks_are_found_with_their_languages() -> None:
    fences = sum(len(re.findall(r"^ *```", path.read_text("utf-8"), re.MULTILINE)) for path in PAGES.values())
    assert 2 * len(BLOCKS) == fences
    assert {block.page for block in BLOCKS} == set(PAGES)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: f"{block.page}-{block.number}")
def test_block_is_known(block: Block) -> None:
    """A block without a language, of another one, or with another command is tried by nothing."""
    if block.language == "sh":
        assert block.commands
        assert [command for command in block.commands if len(rules_of(command)) != 1] == []
    elif block.language in PARSERS:
        CONTENTS[block.page](PARSERS[block.language](block.text))
    else:
        assert block.language in {"python", "text"}
        assert block.text.strip()


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.pattern)
def test_rule_is_of_a_command_and_stands_where_it_says(rule: Rule) -> None:
    assert any(re.fullmatch(rule.pattern, command) for _, command in COMMANDS)
    assert rule.reason
    assert bool(rule.stands) == (rule.tried in {"parsed", "elsewhere"})
    missing = [(name, text) for name, text in rule.stands if text not in (ROOT / name).read_text("utf-8")]
    assert missing == []


@pytest.mark.parametrize(("page", "command"), PARSED)
def test_command_line_reads_options(page: str, command: str) -> None:
    assert page in PAGES
    _, name, *words = shlex.split(command)
    known: Any = load(name)
    while words and words[0] in getattr(known, "commands", {}):
        known = known.commands[words.pop(0)]
    known.make_context(name, words)


def test_files_of_compose_are_services_of_page() -> None:
    """The page's address, volume and image are those of the file."""
    document = yaml.safe_load((ROOT / "docker/compose.yml").read_text("utf-8"))
    page = PAGES["install"].read_text("utf-8")
    assert document["services"]["proxy"]["ports"] == [f"{ADDRESS.removeprefix('http://')}:8000"]
    assert "data" in document["volumes"]
    assert "volume `data`" in page
    assert [service for service in document["services"].values() if "secrets" in service] == []


class Folder:
    """Folder in which the commands of a page run, as in an installed checkout."""

    def __init__(self, path: Path, page: str, sample: Sample, served: Served) -> None:
        self.path, self.page, self.sample, self.served = path, page, sample, served
        self.jobs: list[str] = []
        self.last_id = ""
        (path / ".venv").symlink_to(sys.prefix)
        (path / "robot.vrm").write_bytes(vrm("1.0"))
        (path / "Calib.qca.txt").write_bytes(sample.calibration.read_bytes())
        (path / "videos").mkdir()
        self.put_videos()
        write_simulation(record(replace(SCENES["room"], duration_s=1.0), 0), path)
        # An answer that is no success ends `curl` with an error, as a reader would see one.
        (path / ".curlrc").write_text('fail-with-body\nnoproxy = "127.0.0.1"\n')

    def put_videos(self) -> None:
        for video in self.sample.videos.values():
            num_frames = None if self.page in WHOLE else NUM_FRAMES
            copy_frames(video, self.path / "videos" / video.name, num_frames)

    def run(self, command: str) -> str:
        """Run a command as a page has it, where `ID` is the id of the last answer; return what it prints."""
        command = re.sub(r"\bID\b", self.last_id, command)
        if "/SESSION/" in command:
            job = self.served.client.get(f"/v1/jobs/{self.served.post(self.sample)}").json()
            command = command.replace("SESSION", job["session_id"])
        if "/results" in command:
            self.served.wait_for_end(self.last_id)
        command = command.replace(ADDRESS, str(self.served.client.base_url).rstrip("/"))
        command = re.sub(r"--preview \d+", "--preview 0", command)
        places = {"MULTICAP_DATA_DIR": str(self.path / "data"), "CURL_HOME": str(self.path)}
        done = subprocess.run(
            ["bash", "-c", command], cwd=self.path, env=os.environ | places, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        if "/v1/sample/" in command:
            self.put_videos()
        if re.search(r"/v1/(jobs|characters)$", command):
            self.last_id = str(json.loads(done.stdout)["id"])
            self.jobs += [self.last_id] * command.endswith("/v1/jobs")
        return done.stdout

    def run_python(self, text: str) -> None:
        exec(text.replace(ADDRESS, str(self.served.client.base_url)), {})  # noqa: S102 - our own page


def copy_frames(source: Path, target: Path, num_frames: int | None) -> None:
    """Copy a video, or its first frames, without encoding it again."""
    if num_frames is None:
        target.write_bytes(source.read_bytes())
        return
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        stream = reader.streams.video[0]
        copy = writer.add_stream_from_template(stream)
        for _, packet in zip(range(num_frames), reader.demux(stream), strict=False):
            packet.stream = copy
            writer.mux(packet)


@pytest.fixture(params=list(PAGES))
def folder(
    request: pytest.FixtureRequest, tmp_path: Path, sample: Sample, served: Served, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Folder]:
    monkeypatch.chdir(tmp_path)
    made = Folder(tmp_path, request.param, sample, served)
    yield made
    assert {served.wait_for_end(job)["state"] for job in made.jobs} <= {"succeeded"}


def recipe(target: str) -> list[str]:
    """Lines of a target of the Makefile."""
    found = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    assert found is not None
    return [line.strip().replace("$(BIN)", ".venv/bin") for line in found[1].splitlines()]


@pytest.mark.slow
def test_blocks_of_page_run_as_they_stand(folder: Folder) -> None:
    for block in blocks_of(folder.page):
        if block.language == "python":
            folder.run_python(block.text)
        elif block.language == "sh":
            for command in block.commands:
                (rule,) = rules_of(command)
                if rule.tried == "run":
                    folder.run(command)
                elif rule.tried == "recipe":
                    for line in recipe(command.removeprefix("make ")):
                        folder.run(line)
    # Files that the text of a page names.
    made = {
        "first-take": ["person-1.bvh", "results.zip", "results/metrics.json", "blender/person-1.fbx"],
        "blender": ["blender/take.glb", "build/multicap-1.0.0.zip"],
        "unreal": ["unreal/person-1.fbx", "unreal/take.fbx"],
        "unity": ["unity/person-1.fbx"],
        "maya": ["maya/person-1.fbx"],
        "own-character": ["robot/person-1.character.glb", "robot/person-1.character.fbx", "robot/character.json"],
        "own-cameras": ["sync-report/sync.json"],
        "live": ["take-1/timestamps.csv", "kept/skeletons.json"],
        "README": ["untitled.zip", "results/person-1.bvh"],
    }
    assert [name for name in made.get(folder.page, []) if not (folder.path / name).is_file()] == []
