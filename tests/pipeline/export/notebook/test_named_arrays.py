"""Takes as arrays with names and as tables: the values of `skeletons.json`, in the words of `movement`."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multicap import InputError, PipelineError, Reconstruction, open_keypoints, reconstruct, write_results
from pipeline.export.notebook import named_arrays
from pipeline.motion.angles.compute import joint_angles
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

mpl, plt = pytest.importorskip("matplotlib"), pytest.importorskip("matplotlib.pyplot")
pd, xr = pytest.importorskip("pandas"), pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("walk"), duration_s=2.0), 0, 3), folder)
    return reconstruct(open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0))


@pytest.fixture(autouse=True)
def canvas() -> Iterator[None]:
    mpl.use("agg")
    yield
    plt.close("all")


def test_dataset_has_values_of_skeletons_json(take: Reconstruction, tmp_path: Path) -> None:
    take.to_xarray().to_netcdf(tmp_path / "take.nc")
    write_results(take, tmp_path, exports=())
    people = json.loads((tmp_path / "skeletons.json").read_text())["tracks"]
    with xr.open_dataset(tmp_path / "take.nc") as dataset:
        assert dataset["position"].dims == ("time", "space", "keypoints", "individuals")
        assert dataset["confidence"].dims == ("time", "keypoints", "individuals")
        expected = {"source_software": "Multicap", "ds_type": "poses", "fps": 25.0, "time_unit": "seconds"}
        assert dataset.attrs == expected
        assert len(people) == dataset.sizes["individuals"] > 0
        for number, person in enumerate(people):
            joints_m = [[joint or [np.nan] * 3 for joint in frame] for frame in person["positions_m"]]
            positions_m = np.array(joints_m)
            rows = slice(person["start_frame"], person["start_frame"] + len(positions_m))
            shown = dataset["position"].values[rows, :, :, number].swapaxes(1, 2)
            np.testing.assert_allclose(shown, positions_m, atol=0.5e-4 + 1e-9)
            assert np.isnan(np.delete(dataset["position"].values[..., number], np.r_[rows], 0)).all()


def test_long_table_has_a_row_for_each_known_joint(take: Reconstruction, tmp_path: Path) -> None:
    table = pd.read_parquet(take.to_parquet(tmp_path / "joints.parquet"))
    known = sum(int((track.source > 0).sum()) for track in take.tracks)
    assert len(table) == known
    track = take.tracks[0]
    row = table[(table["person"] == track.track_id) & (table["joint"] == "left_knee")].iloc[-1]
    place = row["frame"] - track.start_frame, take.joints.index("left_knee")
    assert row[["x_m", "y_m", "z_m"]].to_list() == track.xyz_m[place].tolist()
    assert track.uncertainty_m is not None
    assert row["uncertainty_m"] == track.uncertainty_m[place]
    assert row["time_s"] == pytest.approx(row["frame"] / 25.0)


def test_wide_table_of_angles_has_a_row_a_frame(take: Reconstruction) -> None:
    table = take.to_dataframe("angles", form="wide")
    assert table["frame"].to_list() == list(range(take.timebase.num_frames))
    motion, track = take.motions[0], take.tracks[0]
    expected = joint_angles(motion, track, take.joints).angle_deg[:, ANGLE_NAMES.index("left_knee_flexion")]
    shown = table[f"{motion.name}.left_knee_flexion.angle_deg"].to_numpy()[track.frames.start : track.frames.stop]
    np.testing.assert_array_equal(shown, expected)


def test_contacts_have_frames_of_the_motion(take: Reconstruction) -> None:
    stands = [(motion.name, stand, motion) for motion in take.motions for stand in motion.contacts]
    assert stands
    table = take.to_dataframe("contacts")
    assert len(table) == sum(stand.num_frames for _, stand, _ in stands)
    name, stand, motion = stands[0]
    of_foot = table[(table["name"] == name) & (table["foot"] == f"{stand.side}_{stand.part}")]
    assert of_foot["frame"].iloc[0] == motion.start_frame + stand.start_frame
    assert of_foot["contact"].iloc[0] == stand.confidence


def test_plots_show_people_angles_and_views(take: Reconstruction) -> None:
    track, camera = take.tracks[0], take.cameras[1]
    skeletons = take.plot()
    assert len(skeletons.lines) == sum(take.timebase.num_frames // 2 in other.frames for other in take.tracks)
    angle = take.plot(track.track_id, angle="left_knee_flexion")
    assert len(np.array(angle.lines[0].get_xdata())) == track.num_frames
    frame = track.frames[3]
    view = take.plot(track.track_id, camera=camera.name, frame=frame)
    seen_px = np.array(view.lines[1].get_xydata())
    np.testing.assert_array_equal(seen_px, take.observations[0].points_px[3, 1])
    assert view.get_xlim() == (0, camera.size_px[0])


def test_texts_of_take_are_short(take: Reconstruction) -> None:
    assert repr(take).startswith(f"<Reconstruction: {len(take.tracks)} people, ")
    assert all(len(repr(part)) < 400 for part in (take.tracks[0], take.motions[0], take.cameras[0], take.animation))
    html = take._repr_html_()
    assert len(html) < 10_000
    assert html.count("<tr>") == len(take.tracks) + 1
    assert "<svg" in html


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"person": 99}, "person must be one of 1"),
        ({"angle": "knee"}, "angle must be one of pelvis_rotation"),
        ({"camera": "left"}, "camera must be one of cam_00, cam_02, cam_04, not 'left'"),
        ({"frame": -1}, "frame must be a whole number from 0 to "),
    ],
)
def test_plot_of_unknown_part_is_refused(take: Reconstruction, arguments: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        take.plot(**arguments)  # type: ignore[arg-type]


def test_table_of_unknown_content_is_refused(take: Reconstruction) -> None:
    with pytest.raises(InputError, match=r"of must be one of joints, angles, contacts, not 'feet'\.\n.*form must be"):
        take.to_dataframe("feet", "tall")  # type: ignore[arg-type]


def test_missing_package_gets_sentence_with_extra(take: Reconstruction, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(named_arrays, "import_module", missing)
    with pytest.raises(PipelineError, match=r"xarray is not installed.*pip install multicap\[notebook\]"):
        take.to_xarray()
