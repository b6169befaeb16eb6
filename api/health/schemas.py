"""Bodies about the health of the service."""

from pydantic import Field

from api.contract.schemas import ResponseModel


class Health(ResponseModel):
    """Liveness of the API process."""

    status: str = "ok"


class Readiness(ResponseModel):
    """Readiness of the service: a worker could start a job now."""

    status: str = "ready"
    checks: dict[str, bool] = Field(description="Passed checks by name.")
    disk_free_bytes: int = Field(description="Free bytes on the disk of the data folder.")
