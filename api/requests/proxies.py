"""Proxies of videos that browsers can't play: a job of their own, behind a session's first reconstruction."""

from api.dependencies import Services
from pipeline.video.playback.choices import ProxyChoices
from worker.jobs.model.sessions import Session
from worker.jobs.spec import JobSpec
from worker.jobs.tenant_records import TenantRecords
from worker.planning import CheckedSession, has_videos, plan_job
from worker.telemetry import tracing


def queue_proxies(work: TenantRecords, services: Services, session: Session | CheckedSession, session_id: str) -> None:
    """Queue the job that makes a session's proxies, in an open transaction, unless there is one or none is needed."""
    cameras = tuple(camera.name for camera in session.preflight.cameras if camera.media_type is None)
    if not cameras or not has_videos(session) or work.jobs.page(session_id=session_id, kind="proxies", limit=1):
        return
    making = ProxyChoices(cameras)
    stages = plan_job(session, JobSpec(), services.settings.chunk_frames, making=making)
    work.jobs.add(session_id, JobSpec(), stages, None, tracing.current(), making)
