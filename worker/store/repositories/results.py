"""Result files of jobs."""

from sqlalchemy import select

from pipeline.core.options.job_choices import BLURRED_KIND
from pipeline.core.records import from_json
from pipeline.run.engine.stage import VIEWER
from worker.store.database.access import Repository
from worker.store.database.rows import read
from worker.store.database.tables import jobs, results
from worker.store.errors import NoResults, NotFinished, NotFound
from worker.store.model.job_records import JobProblem, Result, is_worth_a_retry
from worker.store.model.states import FINISHED, JobState
from worker.store.repositories.jobs import job_row


class Results(Repository):
    """Results of the jobs of a tenant, or of all tenants."""

    def downloads(self, job_id: str) -> list[Result]:
        """Results of a job for downloads, by name, without the files of viewers; errors like ``all``."""
        return [result for result in self.all(job_id) if result.kind != VIEWER]

    def all(self, job_id: str) -> list[Result]:
        """Results of a job, by name.

        Raises ``NotFound``, ``NotFinished`` if no revision of the job has succeeded yet, or ``NoResults`` if it failed
        or was canceled before.
        """
        query = select(results).where(results.c.job_id == job_id).order_by(results.c.name)
        with self._access.reading() as connection:
            job = job_row(connection, self._access, job_id)
            if job.results_revision is None and job.state not in FINISHED:
                raise NotFinished("The job is unfinished; its results come with its end.")
            found = [read(Result, row) for row in connection.execute(query)]
        if not found and job.results_revision is None:
            problem = from_json(JobProblem, job.problem)
            reason = f"{problem.code}: {problem.detail}" if problem else None
            raise NoResults(job.state, reason, is_worth_a_retry(JobState(job.state), problem))
        return found

    def listed(self, job_id: str, name: str) -> Result | None:
        """Result of a job by name, in whatever state the job is; ``None`` if there is none of this name.

        Raises ``NotFound`` if there is no such job.
        """
        query = select(results).where(results.c.job_id == job_id, results.c.name == name)
        with self._access.reading() as connection:
            job_row(connection, self._access, job_id)
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Result, row)

    def proxy(self, session_id: str, name: str) -> Result | None:
        """Proxy of a session by its name, as soon as it is made; ``None`` before, and without a session."""
        query = (
            select(results)
            .join(jobs)
            .where(jobs.c.session_id == session_id, jobs.c.kind == "proxies", results.c.name == name)
            .where(self._access.may_reach(jobs))
            .order_by(jobs.c.id.desc())
            .limit(1)
        )
        with self._access.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Result, row)

    def blurred(self, session_id: str, name: str) -> Result | None:
        """Blurred video of a session by its name, of the newest job that has made it; ``None`` if none has."""
        query = (
            select(results)
            .join(jobs)
            .where(jobs.c.session_id == session_id, results.c.kind == BLURRED_KIND, results.c.name == name)
            .where(self._access.may_reach(jobs), jobs.c.state != JobState.EXPIRED)
            .order_by(jobs.c.id.desc())
            .limit(1)
        )
        with self._access.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Result, row)

    def get(self, job_id: str, name: str) -> Result:
        """Result of a job by name; errors like ``all``, and ``NotFound`` if there is none of this name."""
        for result in self.all(job_id):
            if result.name == name:
                return result
        raise NotFound("The job has no result of this name.")
