"""Videos of a session are deleted by a request: results stay, and all that needs videos says why it can't be."""

from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, form, keypoint_form, problem_of

VIDEO = b"a video that is deleted"


def send(live: Live) -> str:
    answer = live.client.post("/v1/sessions", files=form(2, VIDEO))
    assert answer.status_code == 201, answer.text
    return str(answer.json()["urls"]["self"])


def finished(live: Live, address: str, **spec: object) -> str:
    answer = live.client.post(f"{address}/jobs", json=spec)
    assert answer.status_code == 202, answer.text
    job_id = str(answer.json()["id"])
    live.finish(job_id, people=[PersonSpan(1, 0, 20)])
    return job_id


def holds_video(live: Live) -> bool:
    return any(path.read_bytes() == VIDEO for path in live.kept())


def test_videos_are_deleted_and_results_stay(live: Live) -> None:
    address = send(live)
    job_id = finished(live, address)
    before = live.client.get(address).json()
    assert holds_video(live)
    for _ in range(2):
        assert live.client.delete(f"{address}/videos").status_code == 204
    assert not holds_video(live)
    session = live.client.get(address).json()
    assert session["videos_deleted_at"] is not None
    assert [(file["kind"], file["is_deleted"]) for file in session["files"]] == [
        ("video", True),
        ("video", True),
        ("calibration", False),
    ]
    assert session["num_bytes"] == before["num_bytes"] - 2 * len(VIDEO)
    assert [(camera["video_url"], camera["thumbnails"]) for camera in session["preflight"]["cameras"]] == [
        (None, [])
    ] * 2
    assert live.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").status_code == 200
    assert live.client.get(f"/v1/jobs/{job_id}/results.zip").status_code == 200
    for path in ("videos/cam_0", "thumbnails/cam_1/0"):
        problem = problem_of(live.client.get(f"{address}/{path}"), 410, "videos_deleted")
        assert "new capture" in problem["hint"]


def test_edits_go_on_and_detection_does_not(live: Live) -> None:
    address = send(live)
    job_id = finished(live, address)
    live.client.delete(f"{address}/videos").raise_for_status()
    problem_of(live.remake(job_id, overlay=True), 409, "videos_deleted")
    answer = live.remake(job_id, exports=["glb"])
    assert answer.status_code == 202, answer.text
    live.finish(job_id, people=[PersonSpan(1, 0, 20)])
    assert live.client.get(f"/v1/jobs/{job_id}").json()["results_revision"] == 1
    problem = problem_of(live.client.post(f"{address}/jobs", json={"profile": "fast"}), 409, "videos_deleted")
    assert "new capture" in problem["hint"]
    problem_of(live.client.post(f"{address}/jobs", json={"overlay": True}), 409, "videos_deleted")
    assert live.client.post(f"{address}/jobs", json={"exports": ["csv"]}).status_code == 202


def test_no_proxies_are_made_of_deleted_videos(live: Live) -> None:
    parts = [("videos", ("cam_0.avi", VIDEO)), form(0)[0]]
    address = str(live.client.post("/v1/sessions", files=parts).json()["urls"]["self"])
    answer = live.client.post(f"{address}/jobs", json={}).json()
    proxies = live.client.get(address).json()["proxies_job"]
    assert proxies is not None
    while claim := live.services.store.leases.claim("test", 30.0):
        live.services.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 0)
    assert live.client.get(f"/v1/jobs/{answer['id']}").json()["state"] == "succeeded"
    assert live.client.delete(f"{address}/videos").status_code == 204
    assert live.client.get(f"/v1/jobs/{proxies['id']}").status_code == 404
    assert live.client.post(f"{address}/jobs", json={"exports": ["csv"]}).status_code == 202
    assert live.client.get(address).json()["proxies_job"] is None


def test_session_without_videos_is_not_copied(live: Live) -> None:
    address = send(live)
    finished(live, address)
    live.client.delete(f"{address}/videos").raise_for_status()
    calibration = live.client.post("/v1/uploads", headers=UPLOAD)
    assert calibration.status_code == 201, calibration.text
    upload_id = calibration.headers["location"].rpartition("/")[2]
    body = {"session_id": address.rpartition("/")[2], "calibration": upload_id}
    problem = problem_of(live.client.post("/v1/sessions", json=body), 422, "invalid_request")
    assert "videos_deleted" in {error["code"] for error in problem["errors"]}


UPLOAD = {"Tus-Resumable": "1.0.0", "Upload-Length": "3", "Upload-Metadata": "filename Yy50b21s"}


def test_when_videos_are_not_deleted(live: Live) -> None:
    address = send(live)
    problem = problem_of(live.client.delete(f"{address}/videos"), 409, "conflict")
    assert "No job of this capture has succeeded" in problem["detail"]
    finished(live, address)
    running = live.client.post(f"{address}/jobs", json={"exports": ["csv"]}).json()
    problem = problem_of(live.client.delete(f"{address}/videos"), 409, "conflict")
    assert running["id"] in problem["detail"]
    assert holds_video(live)
    assert live.client.get(f"{address}/videos/cam_0").content == VIDEO
    keypoints = live.client.post("/v1/sessions", files=keypoint_form()).json()["urls"]["self"]
    problem_of(live.client.delete(f"{keypoints}/videos"), 404, "not_found")
    for path in ("00000000-0000-7000-8000-000000000000", "..%2f..", "nonsense"):
        problem_of(live.client.delete(f"/v1/sessions/{path}/videos"), 404, "not_found")


def test_equal_videos_of_another_session_stay(live: Live) -> None:
    """Each session has files of its own, whatever is in them."""
    address, other = send(live), send(live)
    finished(live, address)
    assert live.client.delete(f"{address}/videos").status_code == 204
    assert holds_video(live)
    assert live.client.get(f"{other}/videos/cam_0").content == VIDEO


def test_choice_of_job_is_strict(live: Live) -> None:
    address = send(live)
    for value in ("no", 0, None):
        answer = live.client.post(f"{address}/jobs", json={"keep_videos": value})
        assert answer.status_code == 422
    job = live.client.post(f"{address}/jobs", json={"keep_videos": False}).json()
    assert job["spec"]["keep_videos"] is False
    assert live.services.store.sessions.with_superfluous_videos() == []
    live.finish(str(job["id"]))
    assert live.services.store.sessions.with_superfluous_videos() == [address.rpartition("/")[2]]
