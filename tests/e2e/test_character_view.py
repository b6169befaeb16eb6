"""Characters in the viewer: loaded when they are chosen, where their files say, in step, hidden with the person."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, Request, Route, expect

from pipeline.core.data.animation import Animation
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.data.rigid import Rigid3
from pipeline.export.character.character_files import write_character_files
from pipeline.export.character.fbx.reader import decode_fbx_character
from pipeline.export.character.figure import CharacterFigure, measure
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.character.writers.character_glb import read_xyz
from pipeline.export.overlay import encode_png
from pipeline.motion.body import installed
from tests.api.conftest import Live, running
from tests.e2e.browsing import axe_findings, opened
from tests.e2e.viewer_takes import crowd, quick_settings, viewer_files_of
from tests.pipeline.export.character.characters import bones_of, character, glb, parts, vrm
from tests.pipeline.export.character.fbx.fbx_characters import fbx_of

NUM_FRAMES, RATE_HZ = 60, 25.0
PRESENT = range(10, 50)
PICTURE_PX = 400
FAR_M = np.array([4000.0, -2500.0, 120.0])
BEYOND = "pictures/beyond.png"

MOUNT = """async (job) => {
  const { mount } = await import("/portal/viewer/mount.js");
  const { ApiSource } = await import("/portal/viewer/mount.js");
  const place = document.createElement("div");
  for (const child of document.body.children) child.hidden = true;
  document.body.prepend(place);
  globalThis.viewer = await mount(place, new ApiSource(job, [], undefined, { hasCharacter: true }));
}"""

# World positions of bones, and of the vertices of the mesh that stand at their heads; null of those who are hidden.
PLACES = """async (frame) => {
  const { Vector3 } = await import("/portal/vendor/three/three.module.js");
  const { viewer } = globalThis;
  viewer.goTo(frame);
  const { stage } = viewer.view;
  stage.scene.updateMatrixWorld(true);
  const origin = viewer.description.origin_m;
  const world = (point) => point.toArray().map((value, axis) => value + origin[axis]);
  const isCharacter = (group) => {
    let found = false;
    group.traverse(({ isBone }) => { found ||= isBone; });
    return found;
  };
  return stage.scene.children.filter(isCharacter).map((group) => {
    if (!group.visible) return null;
    const bones = {};
    let vertices = null;
    group.traverse((node) => {
      if (node.isBone) bones[node.userData.name ?? node.name] = world(node.getWorldPosition(new Vector3()));
      if (!node.isSkinnedMesh) return;
      const heads = Object.fromEntries(node.skeleton.bones.map((bone, place) => [bone.userData.name, 6 * place]));
      const at = (vertex) => world(node.localToWorld(node.getVertexPosition(vertex, new Vector3())));
      vertices = Object.fromEntries(Object.entries(heads).map(([name, vertex]) => [name, at(vertex)]));
    });
    return { bones, vertices };
  });
}"""

# Content of the memory of the graphics, once everything that is seen has been drawn.
MEMORY = """() => {
  const { stage } = globalThis.viewer.view;
  stage.renderer.render(stage.scene, stage.camera);
  return { ...stage.renderer.info.memory };
}"""


def pictured(content: bytes) -> bytes:
    """Character with a picture on its mesh, one that is not in the file, and a shape of the face."""
    document, binary = parts(content)
    binary += bytes(-len(binary) % 4)
    shades = np.random.default_rng(3).integers(0, 30, (PICTURE_PX, PICTURE_PX, 1))
    picture = encode_png((np.array([220, 120, 40]) + shades).astype(np.uint8))
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(picture)})
    document["buffers"][0]["byteLength"] = len(binary) + len(picture)
    document["images"] = [
        {"bufferView": len(document["bufferViews"]) - 1, "mimeType": "image/png"},
        {"uri": BEYOND},
    ]
    document["textures"] = [{"source": 0}, {"source": 1}]
    document["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "emissiveTexture": {"index": 1}},
    ]
    (primitive,) = document["meshes"][0]["primitives"]
    primitive |= {"material": 0, "targets": [{"POSITION": 1}]}
    return glb(document, binary + picture)


def figure_of(name: str, content: bytes) -> CharacterFigure:
    file = decode_character(name, content)
    return measure(file, map_bones(file))


def take(shift_m: np.ndarray) -> Reconstruction:
    """Two people, the second of whom comes later and goes earlier, somewhere in the world."""
    both = crowd(2, NUM_FRAMES, RATE_HZ)
    rows = slice(PRESENT.start, PRESENT.stop)
    columns = ("xyz_m", "score", "source", "error_px", "views")

    def cut(number: int) -> slice:
        return rows if number else slice(None)

    tracks = tuple(
        replace(track, start_frame=cut(n).start or 0, **{name: getattr(track, name)[cut(n)] for name in columns})
        for n, track in enumerate(both.tracks)
    )
    tracks = tuple(replace(track, xyz_m=track.xyz_m + shift_m) for track in tracks)
    motions = tuple(
        replace(
            motion,
            start_frame=cut(n).start or 0,
            root_m=motion.root_m[cut(n)] + shift_m,
            parent_from_joint=motion.parent_from_joint[cut(n)],
            contacts=(),
        )
        for n, motion in enumerate(both.motions)
    )
    observations = tuple(
        replace(seen, points_px=seen.points_px[cut(n)], score=seen.score[cut(n)])
        for n, seen in enumerate(both.observations)
    )
    cameras = tuple(
        replace(
            camera,
            cam_from_world=Rigid3(
                camera.cam_from_world.rotation,
                camera.cam_from_world.translation_m - camera.cam_from_world.rotation @ shift_m,
            ),
        )
        for camera in both.cameras
    )
    floor = both.animation.floor
    if floor is not None:
        floor = replace(floor, z_m=floor.z_m + shift_m[2] - floor.slope_x * shift_m[0] - floor.slope_y * shift_m[1])
    return replace(
        both,
        cameras=cameras,
        located=tracks,
        observations=observations,
        animation=Animation(tracks, motions, floor),
    )


@dataclass(frozen=True)
class Moved:
    """A finished job with a character."""

    job_id: str
    files: Mapping[str, bytes]
    folder: Path

    def places_m(self, number: int, names: tuple[str, ...]) -> np.ndarray:
        """Places of bones in all frames of a person's file."""
        return np.concatenate(list(read_xyz(self.folder / f"person-{number}.character.glb", names)))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(quick_settings(tmp_path_factory.mktemp("characters"))) as service:
        yield service


def moved(
    live: Live, folder: Path, content: bytes | CharacterFigure, rate_hz: float | None = None, *, is_far: bool = False
) -> Moved:
    installed.install()
    scene = take(FAR_M if is_far else np.zeros(3))
    figure = figure_of("a.glb", content) if isinstance(content, bytes) else content
    for _ in write_character_files(scene, figure, folder, frame_rate_hz=rate_hz):
        pass
    files = {path.name: path.read_bytes() for path in folder.glob("*.glb")}
    job_id = live.job_id()
    live.finish(job_id, motion=viewer_files_of(scene, installed.load()), characters=files)
    return Moved(job_id, files, folder)


@pytest.fixture(scope="module")
def walking(live: Live, tmp_path_factory: pytest.TempPathFactory) -> Moved:
    content = pictured(character(bones_of("mixamo"), unit=100.0, armature_scale=0.01))
    return moved(live, tmp_path_factory.mktemp("mixamo"), content)


@pytest.fixture
def page(live: Live) -> Iterator[Page]:
    with opened(str(live.client.base_url)) as opened_page:
        yield opened_page


def mount(page: Page, job_id: str) -> None:
    page.evaluate(MOUNT, job_id)
    expect(page.locator(".look-viewer[data-ready=true]")).to_be_visible(timeout=180_000)
    page.get_by_text("Show", exact=True).click()


def choose_character(page: Page) -> None:
    label = page.get_by_label("Bodies as").locator("option", has_text="My character")
    expect(label).to_be_attached()
    page.get_by_label("Bodies as").select_option("character")
    page.wait_for_function("() => globalThis.viewer.view.people.options.shape === 'character'", timeout=180_000)


def furthest_mm(page: Page, job: Moved, frame: int, rows: Mapping[int, float]) -> list[float | None]:
    """Largest distances of a person's bones and vertices to a row of the file, in mm; ``None`` of a hidden person."""
    found: list[dict[str, Any] | None] = page.evaluate(PLACES, frame)
    distances: list[float | None] = []
    for number, person in enumerate(found, 1):
        if person is None:
            distances.append(None)
            continue
        names = tuple(person["vertices"])
        places_m = job.places_m(number, names)
        row = rows[number]
        before = int(row)
        share = row - before
        expected_m = (1 - share) * places_m[before]
        if share:
            expected_m += share * places_m[before + 1]
        for kind in ("bones", "vertices"):
            shown_m = np.array([person[kind][name] for name in names])
            assert len(names) > 40
            distances.append(1000 * float(np.linalg.norm(shown_m - expected_m, axis=-1).max()))
    return distances


def test_mesh_is_in_place_and_vanishes_with_person(page: Page, walking: Moved) -> None:
    asked: list[str] = []
    parts_of_second: list[str] = []

    def note(request: Request) -> None:
        asked.append(request.url)
        if "person-2.character.glb" in request.url:
            parts_of_second.append(request.headers["range"])

    page.on("request", note)
    mount(page, walking.job_id)
    expect(page.get_by_label("Bodies as").locator("option")).to_have_text(
        ["Humans", "Capsules", re.compile(r"My character \(up to \d+\.\d MB\)")]
    )
    assert not any(".character." in url or "GLTFLoader" in url for url in asked)  # nothing before it is chosen
    choose_character(page)
    for frame in (10, 11, 37, 49):
        distances = furthest_mm(page, walking, frame, {1: frame, 2: frame})
        assert len(distances) == 4
        assert max(distance or 1e9 for distance in distances) < 1.0, (frame, distances)
    for frame in (0, 9, 50, 59):
        *of_first, second = furthest_mm(page, walking, frame, {1: frame})
        assert second is None
        assert max(distance or 1e9 for distance in of_first) < 1.0
    # Only what shows the character is drawn, with the picture that is in the file, and none from elsewhere.
    shown = page.evaluate(
        """() => {
          const { humans, capsules } = globalThis.viewer.view.people;
          let picture = 0;
          const { scene } = globalThis.viewer.view.stage;
          scene.traverse(({ material }) => { picture = material?.map?.image?.width ?? picture; });
          return { humans: humans.mesh.visible, capsules: capsules.visible, picture };
        }"""
    )
    assert shown == {"humans": False, "capsules": False, "picture": PICTURE_PX}
    assert not any(BEYOND in url for url in asked)
    # The mesh is read once, from the first file: of the other one what it describes, and the keys at its end.
    size = len(walking.files["person-2.character.glb"])
    read = [tuple(map(int, part.removeprefix("bytes=").split("-"))) for part in parts_of_second]
    assert read[-1][1] == size - 1
    assert all(last + 1 - first < size for first, last in read)
    expect(page.locator(".look-status")).to_have_text("")
    assert axe_findings(page, ".look-viewer") == []


@pytest.mark.slow
def test_character_moves_and_goes_with_choice(page: Page, walking: Moved) -> None:
    mount(page, walking.job_id)
    before = page.evaluate(MEMORY)
    choose_character(page)
    page.evaluate("() => { globalThis.viewer.player.seek(12); globalThis.viewer.player.play(); }")
    page.wait_for_function("() => globalThis.viewer.player.frame > 20", timeout=180_000)
    page.evaluate("() => globalThis.viewer.player.pause()")
    frame = page.evaluate("() => globalThis.viewer.frame")
    rows = dict.fromkeys((1, 2), frame)
    assert max(distance or 0.0 for distance in furthest_mm(page, walking, frame, rows)) < 1.0
    assert page.evaluate(MEMORY)["geometries"] > before["geometries"]
    # A person who is hidden by the box beside the strip is hidden as a character.
    page.get_by_role("checkbox", name="Show person-2").uncheck()
    assert page.evaluate(PLACES, 20)[1] is None
    page.get_by_role("checkbox", name="Show person-2").check()
    page.get_by_text("Show", exact=True).click()
    page.get_by_label("Bodies", exact=True).uncheck()
    assert page.evaluate(PLACES, 20) == [None, None]
    page.get_by_label("Bodies", exact=True).check()
    page.get_by_label("Bodies as").select_option("capsule")
    assert page.evaluate(PLACES, 20) == []
    assert page.evaluate(MEMORY) == before
    assert page.evaluate("() => globalThis.viewer.view.people.capsules.visible")


@pytest.mark.slow
@pytest.mark.parametrize("is_far", [False, True])
def test_other_rigs_rates_and_places(page: Page, live: Live, is_far: bool, tmp_path: Path) -> None:
    job = moved(live, tmp_path, vrm("0.x"), None if is_far else 50.0, is_far=is_far)
    mount(page, job.job_id)
    choose_character(page)
    rate = 1 if is_far else 2
    for frame in (10, 30):
        distances = furthest_mm(page, job, frame, {1: rate * frame, 2: rate * frame})
        assert len(distances) == 4
        assert max(distance or 1e9 for distance in distances) < 1.0, (frame, distances)


@pytest.mark.slow
def test_character_from_fbx_is_shown(page: Page, live: Live, tmp_path: Path) -> None:
    file = decode_fbx_character("a.fbx", fbx_of(figure_of("a.glb", vrm("1.0")).file, unit_cm=100.0))
    figure = measure(file, map_bones(file, figure_of("a.glb", vrm("1.0")).mapping.bones))
    job = moved(live, tmp_path, figure)
    mount(page, job.job_id)
    choose_character(page)
    for number, person in enumerate(page.evaluate(PLACES, 30), 1):
        names = tuple(person["bones"])
        assert len(names) > 40
        off_m = np.array(list(person["bones"].values())) - job.places_m(number, names)[30]
        assert np.linalg.norm(off_m, axis=-1).max() < 1e-3


def is_of_second(path: Path) -> bool:
    return path.is_file() and "person-2.character.glb" in str(path)


def send_nothing(route: Route) -> None:
    """Answer with zeros for the part that is asked for."""
    first, last = map(int, route.request.headers["range"].removeprefix("bytes=").split("-"))
    route.fulfill(status=206, body=bytes(last + 1 - first))


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        pytest.param("removed", "The file was removed. Start another job", marks=pytest.mark.slow),
        pytest.param("damaged", "damaged", marks=pytest.mark.slow),
        ("cut", "not an animated character, or is damaged"),
    ],
)
def test_missing_or_damaged_file_is_reported(live: Live, tmp_path: Path, harm: str, words: str) -> None:
    content = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)
    job = moved(live, tmp_path, content)
    results = live.client.get(f"/v1/jobs/{job.job_id}/results").json()["results"]
    assert [file["name"] for file in results if file["kind"] == "character"] == sorted(job.files)
    with opened(str(live.client.base_url), allowed=("404", "410", "500")) as page:
        mount(page, job.job_id)
        (stored,) = (path for path in live.settings.data_dir.rglob(f"{job.job_id}/**/*") if is_of_second(path))
        if harm == "removed":
            stored.unlink()
        elif harm == "damaged":
            stored.write_bytes(bytes(stored.stat().st_size))
        else:
            page.route("**/person-2.character.glb*", send_nothing)
        page.get_by_label("Bodies as").select_option("character")
        expect(page.locator(".look-status")).to_contain_text("The character can't be shown: ", timeout=180_000)
        expect(page.locator(".look-status")).to_contain_text(words)
        expect(page.get_by_label("Bodies as")).to_have_value("human")
        expect(page.get_by_label("Loading the character")).to_be_hidden()
        assert page.evaluate("() => globalThis.viewer.view.people.humans.mesh.visible")
        assert page.evaluate(PLACES, 20) == []
