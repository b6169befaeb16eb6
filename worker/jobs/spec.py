"""What a client may ask for."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class JobSpec(BaseModel):
    """A reconstruction's choices. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["tracking", "clustering"] = Field(default="tracking", description="How detections become tracks.")
    detector: Literal["movenet-multipose"] = Field(default="movenet-multipose", description="The 2D joint detector.")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a client should know of these choices, a sentence each."""
        if self.method == "clustering":
            return (
                "Clustering takes whole bodies for evidence: two joints are connected where one detection has both.",
            )
        return ()
