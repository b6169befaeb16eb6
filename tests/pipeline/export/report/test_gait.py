"""Tables of gait and movements in a report."""

from pipeline.core.data.cameras import Timebase
from pipeline.export.report.gait import GAIT_COLUMNS, MOVEMENT_COLUMNS, gait_rows, movement_rows
from pipeline.motion.gait.document import gait_document, movement_documents
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import Act, exercise, gait_of, walk

TIMEBASE = Timebase(0.0, 60.0, 1000)


def figures(act: Act) -> dict[str, object]:
    return {"gait": gait_document(gait_of(act)), "movements": movement_documents(gait_of(act), TIMEBASE)}


def test_each_walker_has_a_row_for_both_feet_and_for_each() -> None:
    rows = gait_rows([("Anna", figures(walk(1.2))), ("Ben", figures(exercise(Gesture.SQUAT)))])
    assert [row[:2] for row in rows] == [("Anna", side) for side in ("both", "left", "right")]
    assert all(len(row) == len(GAIT_COLUMNS) for row in rows)
    document = gait_document(gait_of(walk(1.2)))
    assert document is not None
    length = document["both"]["stride_length_m"]
    assert rows[0][3] == f"{length['mean']:.2f} \N{PLUS-MINUS SIGN} {length['std']:.2f} m"
    assert int(rows[0][2]) == int(rows[1][2]) + int(rows[2][2])


def test_movements_have_their_height_or_depth() -> None:
    acts = exercise(Gesture.COUNTERMOVEMENT_JUMP), exercise(Gesture.SIT), walk(1.2)
    rows = movement_rows([(f"person {number}", figures(act)) for number, act in enumerate(acts)])
    assert all(len(row) == len(MOVEMENT_COLUMNS) for row in rows)
    assert {row[1] for row in rows if row[0] == "person 1"} == {"Sits down", "Stands up from a seat"}
    assert all("by flight time, " in row[4] and "by the hips" in row[4] for row in rows if row[1] == "Jump")
    assert not [row for row in rows if row[0] == "person 2"]
