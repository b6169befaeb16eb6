"""Examples of result files."""

from typing import Any

from api.web.contract.examples import JOB_ID, SHA256

_RESULTS: dict[str, Any] = {
    "results": [
        {
            "name": "person-1.bvh",
            "kind": "bvh",
            "person": "person-1",
            "person_name": "person-1",
            "format": "bvh",
            "preset": "default",
            "download_name": "handshake-take-3_person-1.bvh",
            "media_type": "text/plain; charset=utf-8",
            "num_bytes": 204800,
            "sha256": SHA256,
            "revision": 0,
            "link": f"/v1/jobs/{JOB_ID}/results/person-1.bvh",
        },
        {
            "name": "take.glb",
            "kind": "glb",
            "person": None,
            "person_name": None,
            "format": "glb",
            "preset": None,
            "download_name": "handshake-take-3_take.glb",
            "media_type": "model/gltf-binary",
            "num_bytes": 3145728,
            "sha256": SHA256,
            "revision": 0,
            "link": f"/v1/jobs/{JOB_ID}/results/take.glb",
        },
    ]
}

ANSWERS: dict[str, Any] = {
    "ResultList": _RESULTS,
}
