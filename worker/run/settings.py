"""Settings of workers and reaper, from environment variables that begin with ``MULTICAP_``, or from files."""

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict, SettingsError
from sqlalchemy.exc import SQLAlchemyError

from pipeline.core.options.providers import ProviderChoice
from pipeline.core.options.requirements import Schema, requirement
from worker.run.logs import LogLevel
from worker.store.errors import DamagedDatabase, UnknownSchema
from worker.store.files import artifacts
from worker.store.files.secret_files import S3_KEYS, FileVariableError, file_variable
from worker.store.store import JobStore

_Settings = TypeVar("_Settings", bound=BaseSettings)

_PREFIX = "MULTICAP_"


class UnusableFilesError(SettingsError):
    """Files that variables name can't be used, with a sentence for each variable."""

    def __init__(self, sentences: Sequence[str]) -> None:
        super().__init__("\n".join(sentences))
        self.sentences = sentences


class FileVariables(PydanticBaseSettingsSource):
    """Settings out of files: ``MULTICAP_NAME_FILE`` names the file with the value of ``MULTICAP_NAME``.

    The keys of the bucket, which are no settings, are checked too.
    """

    def get_field_value(self, field: FieldInfo, field_name: str) -> tuple[Any, str, bool]:
        """Text of a setting's file, or ``None``."""
        return file_variable(f"{_PREFIX}{field_name.upper()}"), field_name, False

    def __call__(self) -> dict[str, Any]:
        """Values by setting; raises ``UnusableFilesError`` with all problems."""
        values, sentences = {}, []
        for name, field in self.settings_cls.model_fields.items():
            try:
                text, _, is_complex = self.get_field_value(field, name)
                if text is not None:
                    values[name] = self.prepare_field_value(name, field, text, is_complex)
            except FileVariableError as error:
                sentences.append(str(error))
            except ValueError:
                variable = f"{_PREFIX}{name.upper()}_FILE"
                sentences.append(f"{variable}={os.environ[variable]}: the file must hold JSON.")
        for name in S3_KEYS:
            try:
                file_variable(name)
            except FileVariableError as error:
                sentences.append(str(error))
        if sentences:
            raise UnusableFilesError(sentences)
        return values


def read_settings(kind: type[_Settings]) -> _Settings:
    """Read settings from the environment; exit with a sentence for each wrong variable."""
    try:
        return kind()
    except (ValidationError, SettingsError) as error:
        sys.exit("\n".join(f"error: {sentence}" for sentence in explain(kind, error)))


def explain(kind: type[BaseSettings], error: ValidationError | SettingsError) -> list[str]:
    """Sentences about wrong environment variables, with all allowed values."""
    if isinstance(error, UnusableFilesError):
        return list(error.sentences)
    root = kind.model_json_schema()
    wrong = _undecodable(root) if isinstance(error, SettingsError) else _refused(error)
    sentences = []
    for name, shown in wrong.items():
        schema = root["properties"][name]
        form = "JSON, " if _is_json(schema) else ""
        allowed = f"{form}{requirement(schema, root, null=False)}"
        variable = f"{_PREFIX}{name.upper()}"
        if path := os.environ.get(f"{variable}_FILE"):  # what it holds may be a secret
            sentences.append(f"{variable}_FILE={path}: the file must hold {allowed}.")
        else:
            sentences.append(f"{variable}{shown}: must be {allowed}.")
    return sentences


def _refused(error: ValidationError) -> dict[str, str]:
    """Refused settings with their values, as ``=value``; empty text if an item of a list is wrong."""
    return {
        str(detail["loc"][0]): f"={detail['input']}" if len(detail["loc"]) == 1 else ""
        for detail in reversed(error.errors())
    }


def _undecodable(root: Schema) -> dict[str, str]:
    """Settings that must be JSON and are not, with their values."""
    wrong = {}
    for name, schema in root["properties"].items():
        value = os.environ.get(f"{_PREFIX}{name.upper()}")
        if value is not None and _is_json(schema):
            try:
                json.loads(value)
            except ValueError:
                wrong[name] = f"={value}"
    return wrong


def _is_json(schema: Schema) -> bool:
    return schema.get("type") in {"array", "object"}


def require_usable_database(store: JobStore) -> None:
    """Exit with a message if the database is damaged, or belongs to a newer version of Multicap."""
    try:
        store.require_whole()
        store.require_known_schema()
    except DamagedDatabase as error:
        sys.exit(f"error: {error}\n{error.instructions()}")
    except UnknownSchema as error:
        sys.exit(f"error: {error}")
    except SQLAlchemyError:  # the database may start later
        return


class SharedSettings(BaseSettings):
    """Settings of the web API and the workers: storage, broker, logs, webhooks."""

    model_config = SettingsConfigDict(env_prefix=_PREFIX, frozen=True, use_attribute_docstrings=True)

    data_dir: Path = Field(default_factory=artifacts.default_data_dir)
    """Data folder: database, stored files, unfinished uploads, logs. Default: `service` in the user's data folder."""
    database_url: str = ""
    """SQLAlchemy URL of the database, such as postgresql://user:password@host/name; without it SQLite in data_dir."""
    artifacts_url: str = Field(default="", pattern=artifacts.ARTIFACTS_URL, examples=["s3://bucket/prefix"])
    """Bucket and prefix of stored files; without it they are in data_dir."""
    broker_url: str = "redis://127.0.0.1:6379/0"
    """URL of Celery's broker; `multicap serve` sets it."""
    log_level: LogLevel = Field(default="info", description="Lowest level of the events that are logged.")
    headroom_bytes: int | None = Field(default=None, ge=0)
    """Bytes on the disk of data_dir that are kept free. With fewer free bytes nothing new is accepted (507), and
    workers start no chunk. Default: 5 % of the disk, at most 256 MiB."""
    webhook_private: bool = False
    """True if webhooks may go to addresses of private networks and of this machine, also without TLS. Set it for the
    API and the reaper."""

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Arguments, environment, and files that variables name."""
        return init_settings, env_settings, FileVariables(settings_cls)

    @property
    def resolved_database_url(self) -> str:
        """``database_url``, or SQLite in the data folder."""
        return self.database_url or f"sqlite:///{self.data_dir / 'multicap.db'}"


class WorkerSettings(SharedSettings):
    """Leases and limits of workers and reaper."""

    cache_bytes: int = Field(default=artifacts.DEFAULT_CACHE_BYTES, gt=0)
    """Largest size of a worker's copies in data_dir of videos at artifacts_url, without copies in use."""
    cache_hours: float = Field(
        default=artifacts.DEFAULT_CACHE_HOURS, gt=0, description="Time for which an unused copy is kept."
    )
    lease_s: float = Field(default=20.0, gt=0)
    """Time without a heartbeat after which a worker loses its chunk."""
    heartbeat_s: float = Field(default=2.0, gt=0)
    """Time between heartbeats, with which a worker reports its progress and learns of a cancel."""
    visuals_rest_s: float = Field(default=300.0, ge=0)
    """Time after the last edit of a capture's people at which overlay videos, report and recording of a job are
    rebuilt; 0: only on request."""
    reap_interval_s: float = Field(default=5.0, gt=0)
    """Time between two checks of the reaper for lost work."""
    nice: int = Field(default=10, ge=0, le=19)
    """Niceness of workers: it lowers their priority, so that an API on the same machine answers."""
    memory_bytes: int = Field(default=7 * 2**29, ge=2**29)
    """Memory of a worker process without code and unused reserves (RLIMIT_DATA). A chunk that needs more ends its job
    with `memory_limit`; the worker continues."""
    machine_memory_bytes: int | None = Field(default=None, gt=0)
    """Memory that the chunks at work on a machine may need together by the forecast; a further chunk waits. Default:
    nine tenths of the machine's memory, or of the container's limit (of cgroups of version 2; set it under version
    1)."""
    reserve_gpu: bool = False
    """True if a worker with a GPU takes chunks of networks alone, while ready workers without a GPU run the others;
    otherwise it takes chunks of networks first."""
    provider: ProviderChoice = "auto"
    """Provider of the workers' networks, see `multicap help providers`; auto is CUDA where it works, else the CPU."""
    chunk_time_factor: float = Field(default=10.0, gt=0)
    """A chunk is stopped after ten minutes and this many times the time foreseen for it: a tenth of a second for each
    of its units, such as frames of a camera."""
    claim_for_s: float = Field(default=300.0, gt=0)
    """Time for which a worker claims chunks after one message."""

    def open_artifacts(self) -> artifacts.ArtifactStore:
        """Open the artifact store."""
        return artifacts.open_artifacts(self.artifacts_url, self.data_dir, self.cache_bytes, self.cache_hours)
