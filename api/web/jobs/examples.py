"""Examples of jobs."""

from typing import Any

from api.web.contract.examples import JOB_ID, SESSION_ID
from pipeline.run.engine.plan import STAGE_BY_NAME
from pipeline.run.engine.stage import (
    ASSOCIATE,
    DETECT,
    EXPECT,
    EXPORT,
    FIT,
    HOLD,
    IDENTIFY,
    LOOK,
    REDETECT,
)

SPEC: dict[str, Any] = {
    "method": "tracking",
    "profile": "balanced",
    "joints": "auto",
    "detector": "auto",
    "smoothing": "fit",
    "cutoff_hz": 6.0,
    "follow_s": 0.0,
    "feet": "auto",
    "joint_centers": "auto",
    "refine_calibration": "off",
    "sync": "declared",
    "frame_range": None,
    "output_rate_hz": None,
    "people": "auto",
    "exports": ["bvh"],
    "timeline": "take",
    "body": "capsules",
}


def stage(name: str, state: str, done: int, total: int) -> dict[str, Any]:
    """Build a stage of a job."""
    started = state in {"running", "done"}
    return {
        "name": name,
        "label": STAGE_BY_NAME[name].label,
        "state": state,
        "done": done,
        "total": total,
        "unit": STAGE_BY_NAME[name].unit,
        "fraction": done / total,
        "started_at": "2026-03-01T09:31:01Z" if started else None,
        "finished_at": None,
        "reused": False,
    }


JOB: dict[str, Any] = {
    "id": JOB_ID,
    "kind": "reconstruction",
    "calibration_id": None,
    "session_id": SESSION_ID,
    "session_name": "Handshake, take 3",
    "num_frames": 300,
    "duration_s": 12.0,
    "state": "running",
    "spec": SPEC,
    "attempt": 1,
    "revision": 0,
    "results_revision": None,
    "visuals_job": None,
    "provider": "cpu",
    "stages": [
        stage(LOOK, "done", 24, 24),
        stage(DETECT, "running", 150, 600),
        stage(ASSOCIATE, "waiting", 0, 1),
        stage(EXPECT, "waiting", 0, 1),
        stage(REDETECT, "waiting", 0, 60),
        stage(IDENTIFY, "waiting", 0, 1),
        stage(FIT, "waiting", 0, 1),
        stage(HOLD, "waiting", 0, 1),
        stage(EXPORT, "waiting", 0, 1),
    ],
    "progress": 0.24,
    "queue_position": None,
    "eta_s": 19.0,
    "created_at": "2026-03-01T09:31:00Z",
    "started_at": "2026-03-01T09:31:01Z",
    "finished_at": None,
    "expires_at": None,
    "error": None,
    "waiting_for": None,
    "warnings": [],
    "result_warnings": [],
    "space": {"store_bytes": 8800000, "scratch_bytes": 3700000, "num_people": 3},
    "links": {
        "self": f"/v1/jobs/{JOB_ID}",
        "session": f"/v1/sessions/{SESSION_ID}",
        "attempts": f"/v1/jobs/{JOB_ID}/attempts",
        "events": f"/v1/jobs/{JOB_ID}/events",
        "results": f"/v1/jobs/{JOB_ID}/results",
        "results_zip": f"/v1/jobs/{JOB_ID}/results.zip",
        "people": None,
        "cancel": f"/v1/jobs/{JOB_ID}/cancel",
        "visuals": None,
        "retry": None,
    },
}

_ATTEMPTS: dict[str, Any] = {
    "attempts": [
        {
            "attempt": 1,
            "state": "running",
            "queued_at": "2026-03-01T09:31:00Z",
            "started_at": "2026-03-01T09:31:01Z",
            "finished_at": None,
            "error": None,
            "failures": [
                {
                    "stage": DETECT,
                    "chunk": 2,
                    "chunk_try": 1,
                    "failed_at": "2026-03-01T09:31:40Z",
                    "reason": {
                        "code": "worker_lost",
                        "detail": f"A worker of the stage {DETECT} stopped responding.",
                        "stage": DETECT,
                        "camera": None,
                        "hint": "It may lack memory.",
                        "retryable": True,
                        "errors": [],
                    },
                }
            ],
        }
    ]
}

ANSWERS: dict[str, Any] = {
    "Job": JOB,
    "JobPage": {"jobs": [JOB], "next_cursor": None},
    "AttemptList": _ATTEMPTS,
}
