"""Resources of the web API: the one place where each is registered."""

from api.calibrations import routes as calibrations
from api.callers import routes as callers
from api.characters import routes as characters
from api.contract.resource import Resource
from api.events import routes as events
from api.health import routes as health
from api.jobs import routes as jobs
from api.links import routes as links
from api.live import routes as live
from api.motion import routes as motion
from api.options import routes as options
from api.people import routes as people
from api.recordings import routes as recordings
from api.recordings import sockets
from api.results import routes as results
from api.sessions import routes as sessions
from api.sessions import thumbnails, videos
from api.uploads import routes as uploads

RESOURCES: tuple[Resource, ...] = (
    uploads.RESOURCE,
    calibrations.CREATION,
    characters.CREATION,
    sessions.CREATION,
    calibrations.RESOURCE,
    characters.RESOURCE,
    sessions.RESOURCE,
    videos.RESOURCE,
    thumbnails.RESOURCE,
    jobs.CREATION,
    jobs.RESOURCE,
    events.RESOURCE,
    links.RESOURCE,
    live.RESOURCE,
    recordings.RESOURCE,
    sockets.RESOURCE,
    results.RESOURCE,
    motion.RESOURCE,
    people.RESOURCE,
    options.RESOURCE,
    uploads.DESCRIPTION,
    callers.RESOURCE,
    health.RESOURCE,
)
"""All resources, in the order of their routes in the contract."""
