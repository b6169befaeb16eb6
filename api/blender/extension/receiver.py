"""Receiver of a live capture: an armature of the scene moves like the person received at a port of this machine."""

import socket
from collections.abc import Mapping
from typing import Any

import bpy

from api.blender.extension import characters
from api.blender.extension.answers import RequestError
from api.blender.extension.bone_tree import add_trunk
from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.retarget import Retargeting
from api.blender.extension.vmc_person import VmcPerson, is_same_person
from api.blender.extension.work import panel_state, redraw, say
from pipeline.export.character.bone_names import HIPS

_HOST = "127.0.0.1"
_TICK_S = 1 / 60
# Packets that are read at once; with more the latest ones wait for the next time.
_MAX_PACKETS, _MAX_PACKET_BYTES = 256, 65_535


class LiveReceiver:
    """Armature that moves like a person of a live capture.

    The action that the armature has rests meanwhile. Raises ``RequestError`` if the port can't be used, or bones are
    missing.
    """

    def __init__(self, armature: Any, bones: Mapping[str, str], port: int) -> None:
        characters.check_bones(armature, bones)
        self._bones = add_trunk(characters.read_tree(armature), bones)
        self._name, self._port = armature.name, port
        self._person, self._is_moving = VmcPerson(), False
        self._rest: PersonMotion | None = None
        self._poses: Retargeting | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            raise RequestError(f"Port {port} can't be used: another program has it. Choose another one.") from error
        self._socket.setblocking(False)
        moving = armature.animation_data
        self._action: Any = None if moving is None else moving.action
        self._slot: Any = getattr(moving, "action_slot", None)  # Blender before 4.4 has none
        if self._action is not None:
            moving.action = None
        characters.to_rest(armature)
        say(f"{armature.name} waits for a live capture at port {port} of this machine.")

    def step(self) -> None:
        """Take what has come, and move the armature. Raises ``RequestError`` if it is gone, or its bones are."""
        armature = bpy.data.objects.get(self._name)
        if armature is None or armature.type != "ARMATURE":
            raise RequestError(f"The armature {self._name} is no longer there.")
        for _ in range(_MAX_PACKETS):
            try:
                packet = self._socket.recv(_MAX_PACKET_BYTES)
            except OSError:  # nothing has come
                break
            if not self._person.take(packet) and not self._is_moving:
                say(f"What comes to port {self._port} is not a live capture (VMC).", is_error=True)
        if not self._person.is_new or not self._person.is_complete or armature.mode == "EDIT":
            return
        rest = self._person.rest()
        if self._poses is None or self._rest is None or not is_same_person(rest, self._rest):
            self._rest, self._poses = rest, Retargeting(rest, characters.read_rest(armature), self._bones)
        pose = self._poses.pose(*self._person.pose())
        if not set(pose.turns) <= set(armature.pose.bones.keys()):
            raise RequestError(f"The bones of {self._name} have changed. Begin again.")
        for bone, turn in pose.turns.items():
            armature.pose.bones[bone].rotation_quaternion = turn
        armature.pose.bones[self._bones.bones[HIPS]].location = pose.hips
        if not self._is_moving:
            self._is_moving = True
            say(f"{self._name} moves as the person of the live capture.")

    def close(self) -> None:
        """Close the port, and give the armature its action again."""
        self._socket.close()
        armature = bpy.data.objects.get(self._name)
        if armature is not None and self._action is not None:
            armature.animation_data.action = self._action
            if self._slot is not None:
                armature.animation_data.action_slot = self._slot


class CurrentReceiver:
    """Receiver that runs, if one does."""

    def __init__(self) -> None:
        self.receiver: LiveReceiver | None = None

    def start(self, armature: Any, bones: Mapping[str, str], port: int) -> None:
        """Begin to receive. Raises ``RequestError`` as ``LiveReceiver``."""
        self.receiver = LiveReceiver(armature, bones, port)
        panel_state().is_receiving = True
        bpy.app.timers.register(_tick, first_interval=_TICK_S, persistent=True)

    def stop(self) -> None:
        """Stop receiving."""
        if self.receiver is not None:
            self.receiver.close()
        self.receiver = None
        panel_state().is_receiving = False
        if bpy.app.timers.is_registered(_tick):
            bpy.app.timers.unregister(_tick)

    def step(self) -> bool:
        """Move the armature; return whether it continues."""
        if self.receiver is None:
            return False
        try:
            self.receiver.step()
        except RequestError as error:
            self.stop()
            say(str(error), is_error=True)
        redraw()
        return self.receiver is not None


live = CurrentReceiver()
"""Receiver of this Blender."""


def _tick() -> float | None:
    return _TICK_S if live.step() else None
