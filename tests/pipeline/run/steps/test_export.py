"""Result files of the stage ``export`` as clients know them."""

from pathlib import Path

from pipeline.run.steps.export import _result_file


def test_files_of_people_and_of_everybody() -> None:
    names = {1: "Anna"}
    person, everybody, skeletons = (
        _result_file(Path(name), names) for name in ("person-1.glb", "take.glb", "skeletons.json")
    )
    assert (person.kind, person.person, person.person_name) == ("glb", 1, "Anna")
    assert (everybody.kind, everybody.person, everybody.person_name) == ("glb", None, None)
    assert everybody.media_type == person.media_type == "model/gltf-binary"
    assert (skeletons.kind, skeletons.person) == ("skeletons", None)
