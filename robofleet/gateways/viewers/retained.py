"""Rare messages, kept for viewers that come later."""

from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

_WHOLE = "/tf_static", "/log"  # the newest message says all; of the log the newest line
_LENS = "/calibration"  # of any camera
_SCENES = "/arena", "/fleet"  # entities stay until they are taken away


class RetainedMessages:
    """The newest message of each rare topic."""

    def __init__(self) -> None:
        self._newest: dict[str, bytes] = {}
        self._scenes: dict[str, dict[str, SceneEntity]] = {}

    def take(self, topic: str, message: bytes) -> None:
        if topic in _WHOLE or topic.endswith(_LENS):
            self._newest[topic] = message
        elif topic in _SCENES:
            entities = self._scenes.setdefault(topic, {})
            update = SceneUpdate.FromString(message)
            for gone in update.deletions:
                if gone.type == SceneEntityDeletion.ALL:
                    entities.clear()
                entities.pop(gone.id, None)
            entities.update((entity.id, entity) for entity in update.entities)

    def of(self, topic: str) -> bytes | None:
        """Return the message that a new viewer needs."""
        if topic in self._scenes:
            return SceneUpdate(entities=self._scenes[topic].values()).SerializeToString()
        return self._newest.get(topic)
