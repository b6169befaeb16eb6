import sys
import time
from pathlib import Path

from multicap_client import AuthenticatedClient
from multicap_client.api.jobs import create_session_and_job_from_files, get_job
from multicap_client.api.results import get_result, list_results
from multicap_client.models import CaptureForm, JobSpec, Manifest, ProblemDetails
from multicap_client.types import File

url, key, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])


def file(path: Path) -> File:
    return File(payload=path.open("rb"), file_name=path.name)


form = CaptureForm(
    videos=[file(path) for path in sorted(folder.glob("*.mp4"))],
    calibration=file(folder / "calibration.toml"),
    manifest=Manifest(name="Walk"),
    spec=JobSpec.from_dict({"exports": ["bvh", "glb"], "frame_range": [0, 20]}),
)
with AuthenticatedClient(base_url=url, token=key, raise_on_unexpected_status=True) as client:
    job = create_session_and_job_from_files.sync(client=client, body=form)
    if isinstance(job, ProblemDetails):
        sys.exit("\n".join([job.detail, *(error.message for error in job.errors)]))
    while job.state in ("queued", "running"):
        time.sleep(1)
        job = get_job.sync(job.id, client=client)
    for result in list_results.sync(job.id, client=client).results:
        content = get_result.sync(job.id, result.name, client=client)
        Path(result.name).write_bytes(content.payload.read())
