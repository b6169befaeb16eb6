"""Reports of calibrations that were made."""

import json

import numpy as np

from pipeline.calibration.report import CalibrationResult, CameraReport, report_document
from pipeline.core.errors import Problem
from pipeline.core.findings import from_problem
from pipeline.core.problems.finding_codes import FEW_VIEWS


def test_report_as_json_has_no_number_that_is_not_finite() -> None:
    camera = CameraReport("cam_1", 0.21, 1012.5, 30, 0.1, np.inf, np.nan)
    doubt = Problem(FEW_VIEWS, "30 views of 8 cameras.", camera="cam_1", hint="Film the corners.")
    made = CalibrationResult((), False, (camera,), np.nan, (doubt,), "Unknown.")
    document = json.loads(json.dumps(report_document(made), allow_nan=False))
    assert document["reprojection_error_px"] is None
    assert document["cameras"][0]["focal_px"] == 1012.5
    assert document["cameras"][0]["position_sigma_mm"] is None
    assert document["warnings"] == [from_problem(doubt, "warning").to_json()]
