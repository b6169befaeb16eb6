"""AsyncAPI documents of the WebSockets: their examples are messages."""

import json

import pytest
from pydantic import BaseModel

from api.web.live.schemas import RECEIVED, SENT, describe_live
from api.web.recordings.messages import HOST_RECEIVED, HOST_SENT, PHONE_RECEIVED, PHONE_SENT, describe_recordings

MODELS = {
    model.__name__: model for model in (*RECEIVED, *SENT, *PHONE_RECEIVED, *PHONE_SENT, *HOST_RECEIVED, *HOST_SENT)
}
EXAMPLES = {
    name: message["examples"][0]["payload"]
    for document in (describe_live(), describe_recordings())
    for name, message in document["components"]["messages"].items()
    if "examples" in message
}


def test_all_messages_have_examples() -> None:
    assert EXAMPLES.keys() == MODELS.keys()


@pytest.mark.parametrize(("name", "model"), MODELS.items(), ids=MODELS)
def test_examples_are_messages(name: str, model: type[BaseModel]) -> None:
    message = model.model_validate_json(json.dumps(EXAMPLES[name]))
    assert message.model_dump(mode="json", exclude_unset=True) == EXAMPLES[name]
    assert '"..."' not in json.dumps(EXAMPLES[name])
