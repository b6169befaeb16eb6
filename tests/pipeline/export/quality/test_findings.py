from dataclasses import replace

from pipeline.core.findings import Finding
from pipeline.core.problems.findings import CAMERA_BELOW_FLOOR, DISTORTION_FOLDS
from pipeline.core.problems.requests import CALIBRATION_UNPOSED
from pipeline.export.quality.findings import join_findings, people_findings
from pipeline.export.quality.report import quality_report
from tests.pipeline.export.quality.test_report import reconstruction
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker

DOUBT = Finding(CAMERA_BELOW_FLOOR, "The camera is 0.40 m below z = 0.", "a")


def test_a_mirrored_world_is_an_error_and_a_wrong_floor_a_warning() -> None:
    mirrored = walker(60) * [-1.0, 1.0, 1.0] + [0.0, 0.0, 0.4]
    found = people_findings(quality_report(reconstruction(track_of(mirrored))))
    assert [(one.code, one.severity) for one in found] == [
        ("floor_not_at_zero", "warning"),
        ("mirrored_world", "error"),
    ]
    assert found[1].evidence == {"share": 1.0}
    assert found[1].hint is not None


def test_people_decide_where_the_floor_is() -> None:
    found = people_findings(quality_report(reconstruction(track_of(walker(60)))))
    assert found == []
    assert join_findings([DOUBT], found) == []


def test_people_outweigh_errors_of_cameras_alone_but_for_those_with_which_nobody_is_located() -> None:
    folds = Finding(DISTORTION_FOLDS, "The distortion folds the picture.", "a", "error")
    unposed = Finding(CALIBRATION_UNPOSED, "All cameras have the same pose.", None, "error")
    joined = join_findings([folds, unposed], [])
    assert [(finding.code, finding.severity) for finding in joined] == [
        ("distortion_folds", "warning"),
        ("calibration_unposed", "error"),
    ]
    nobody = people_findings(quality_report(reconstruction()))
    assert join_findings([folds], nobody) == [replace(folds, severity="warning"), *nobody]


def test_nobody_decides_nothing() -> None:
    found = people_findings(quality_report(reconstruction()))
    assert [(one.code, one.severity) for one in found] == [("nobody_found", "error")]
    assert join_findings([DOUBT], found) == [DOUBT, *found]
