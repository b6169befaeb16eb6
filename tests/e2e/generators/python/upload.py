import base64
import sys
from pathlib import Path

from multicap_client import AuthenticatedClient
from multicap_client.api.jobs import create_session_and_job_from_uploads
from multicap_client.api.uploads import continue_upload, create_upload
from multicap_client.models import JobSpec, UploadedCapture
from multicap_client.types import File

url, key, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
TUS = {"tus_resumable": "1.0.0"}


def upload(path: Path) -> str:
    begun = create_upload.sync_detailed(
        client=client,
        upload_length=str(path.stat().st_size),
        upload_metadata="filename " + base64.b64encode(path.name.encode()).decode(),
        **TUS,
    )
    upload_id = begun.headers["Location"].rpartition("/")[2]
    with path.open("rb") as content:
        continue_upload.sync_detailed(upload_id, client=client, body=File(content), upload_offset="0", **TUS)
    return upload_id


with AuthenticatedClient(base_url=url, token=key, raise_on_unexpected_status=True) as client:
    capture = UploadedCapture(
        videos=[upload(path) for path in sorted(folder.glob("*.mp4"))],
        calibration=upload(folder / "calibration.toml"),
        spec=JobSpec.from_dict({"exports": ["bvh", "glb"], "frame_range": [0, 20]}),
    )
    sys.stdout.write(str(create_session_and_job_from_uploads.sync(client=client, body=capture).id))
