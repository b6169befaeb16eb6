"""Calibrations of live captures: stored ones have the same rules as in sessions."""

from tests.api.conftest import Live
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import start_message


def test_stored_calibration_without_poses_is_refused(live_service: Live) -> None:
    report = {"has_extrinsics": False}
    stored = live_service.services.store.calibrations.add("Lenses", {}, '{"cameras": []}', "board", report)
    with opened(live_service) as connection:
        client = LiveSocket(connection)
        client.send(start_message(calibration=None, calibration_id=stored.id))
        (error,) = client.problem()["errors"]
    assert (error["code"], error["pointer"]) == ("calibration_unposed", "/calibration_id")
    assert error["hint"] == "Make one from videos that cameras share."
