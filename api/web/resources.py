"""Resources of the web API: the one place where each is registered."""

from api.web import callers, edits, links, motion, options, results
from api.web.calibrations import routes as calibrations
from api.web.characters import routes as characters
from api.web.contract.description import Resource
from api.web.events import routes as events
from api.web.health import routes as health
from api.web.jobs import routes as jobs
from api.web.live import routes as live
from api.web.recordings import routes as recordings
from api.web.recordings import sockets
from api.web.sessions import routes as sessions
from api.web.sessions import videos
from api.web.uploads import routes as uploads

RESOURCES: tuple[Resource, ...] = (
    uploads.RESOURCE,
    uploads.FETCHES,
    calibrations.CREATION,
    characters.CREATION,
    sessions.CREATION,
    calibrations.RESOURCE,
    characters.RESOURCE,
    sessions.RESOURCE,
    videos.RESOURCE,
    jobs.CREATION,
    jobs.RESOURCE,
    events.RESOURCE,
    links.RESOURCE,
    live.RESOURCE,
    recordings.RESOURCE,
    sockets.RESOURCE,
    results.RESOURCE,
    motion.RESOURCE,
    edits.RESOURCE,
    options.RESOURCE,
    uploads.DESCRIPTION,
    callers.RESOURCE,
    health.RESOURCE,
)
"""All resources, in the order of their routes in the contract."""
