"""Examples of links."""

from typing import Any

from api.web.contract.examples import JOB_ID

LINK_ID = "01890a66-3b8e-7a60-9d11-7c8d9e0f1a2b"

SPEC: dict[str, Any] = {"scope": "file", "name": "person-1.bvh", "expires_in_s": 900.0}

_LINK: dict[str, Any] = {
    "id": LINK_ID,
    "job_id": JOB_ID,
    "scope": "file",
    "name": "person-1.bvh",
    "created_at": "2026-03-01T09:40:00Z",
    "expires_at": "2026-03-01T09:55:00Z",
}

ANSWERS: dict[str, Any] = {
    "NewLink": _LINK | {"url": f"/v1/jobs/{JOB_ID}/results/person-1.bvh?link=mcl_..."},
    "LinkList": {"links": [_LINK]},
}
