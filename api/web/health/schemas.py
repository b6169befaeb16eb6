"""Bodies about the health of the service."""

from pydantic import Field

from api.web.contract.schemas import ResponseModel
from pipeline.core.options.providers import ProviderName


class Health(ResponseModel):
    """Liveness of the API process."""

    status: str = "ok"
    version: str = Field(description="Version of Multicap, as `multicap --version` prints it.")


class ProviderOut(ResponseModel):
    """Execution provider of the networks of some worker processes."""

    name: ProviderName = Field(description="Name, such as `cuda`.")
    device: str = Field(description="Name of its device; empty if it tells none.")
    note: str = Field(description="Why it is not the one that was asked for; empty if it is.")
    workers: int = Field(description="Number of ready worker processes with it.")


class Readiness(ResponseModel):
    """Readiness of the service: a worker could start a job now."""

    status: str = "ready"
    checks: dict[str, bool] = Field(description="Passed checks by name.")
    providers: tuple[ProviderOut, ...] = Field(description="Execution providers of the ready worker processes.")
    disk_free_bytes: int = Field(description="Free bytes on the disk of the data folder.")
