"""Receiver of a live capture: armatures of the scene move like the people received at ports of this machine.

Each person has a port, from the first one on. A person without an armature gets a simple one. Poses of a take are kept
here until it ends: what is undone in the scene meanwhile loses none of them.
"""

import socket
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import bpy

from api.blender.extension import characters
from api.blender.extension.answers import RequestError
from api.blender.extension.bone_tree import BoneMap, add_trunk
from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.retarget import Retargeting
from api.blender.extension.scene import scene_rate_hz
from api.blender.extension.take import LiveTake
from api.blender.extension.vmc_person import VmcPerson, is_same_person
from api.blender.extension.work import do_steps, panel_state, redraw, say
from pipeline.export.character.bone_names import HIPS

_HOST = "127.0.0.1"
_TICK_S = 1 / 60
# Packets that are read at once; with more the latest ones wait for the next time.
_MAX_PACKETS, _MAX_PACKET_BYTES = 256, 65_535


class _Performer:
    """Person at a port, and the armature that moves like it."""

    def __init__(self, number: int, port: int) -> None:
        self.number, self._port, self.armature = number, port, ""
        self._person, self._is_told = VmcPerson(), False
        self._bones: BoneMap | None = None
        self._rest: PersonMotion | None = None
        self._poses: Retargeting | None = None
        self._action = ""  # Action that rests meanwhile
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            raise RequestError(f"Port {port} can't be used: another program has it. Choose another one.") from error

    def take_armature(self, armature: Any) -> None:
        """Have an armature of the scene move; its action rests. Raises ``RequestError`` if bones are missing."""
        bones = characters.known_bones(armature)
        characters.check_bones(armature, bones)
        self._bones, self._poses = add_trunk(characters.read_tree(armature), bones), None
        self.armature = armature.name
        self.rest_action(armature)
        characters.to_rest(armature)

    def rest_action(self, armature: Any) -> None:
        """Let the action of the armature rest until ``close``."""
        data = armature.animation_data
        if data is not None and data.action is not None:
            self._action, data.action = data.action.name, None

    def find_armature(self) -> Any:
        """Armature of the person; a simple one for a person who has none, or has none any more."""
        armature = characters.find_armature(self.armature)
        if armature is None:
            if self.armature:
                say(f"The armature {self.armature} is no longer there: person {self.number} has a simple one.")
            armature = characters.add_armature(f"Person {self.number}", self._person.rest())
            self._action = ""
            self.take_armature(armature)
            setattr(panel_state(), f"live_{self.number}", armature.name)
        return armature

    def step(self, take: LiveTake | None) -> bool:
        """Take what has come, and move the armature; return whether it moved. Raises ``RequestError``."""
        for _ in range(_MAX_PACKETS):
            try:
                packet = self._socket.recv(_MAX_PACKET_BYTES)
            except OSError:  # nothing has come
                break
            if not self._person.take(packet) and self._poses is None and not self._is_told:
                self._is_told = True
                say(f"What comes to port {self._port} is not a live capture (VMC).", is_error=True)
            if take is not None and self._person.is_new and self._person.is_complete:
                person, now_s = self._person, time.monotonic()
                take.add(self.number, now_s, person.time_s, person.rest(), person.pose())
                person.is_new = True
        if not self._person.is_new or not self._person.is_complete:
            return False
        armature = self.find_armature()
        if armature.mode == "EDIT" or self._bones is None:
            return False
        rest = self._person.rest()
        if self._poses is None or self._rest is None or not is_same_person(rest, self._rest):
            self._rest, self._poses = rest, Retargeting(rest, characters.read_rest(armature), self._bones)
        pose = self._poses.pose(*self._person.pose())
        if not set(pose.turns) <= set(armature.pose.bones.keys()):
            raise RequestError(f"The bones of {self.armature} have changed. Begin again.")
        for bone, turn in pose.turns.items():
            armature.pose.bones[bone].rotation_quaternion = turn
        armature.pose.bones[self._bones.bones[HIPS]].location = pose.hips
        return True

    def put_on(self, motion: PersonMotion, name: str, first_frame: int) -> Iterator[float]:
        """Put the motion of a take on the armature; it rests until ``close``."""
        armature = self.find_armature()
        yield from characters.put_on(armature, motion, f"{name} {armature.name}", first_frame)
        self.rest_action(self.find_armature())

    def close(self) -> None:
        """Close the port, and give the armature its action: the last take, or the action from before."""
        self._socket.close()
        armature, action = characters.find_armature(self.armature), bpy.data.actions.get(self._action)
        if armature is not None and action is not None:
            (armature.animation_data or armature.animation_data_create()).action = action


class LiveReceiver:
    """Receiver that runs, if one does, and its take."""

    def __init__(self) -> None:
        self.performers: list[_Performer] = []
        self.take: LiveTake | None = None
        self._ending: Iterator[float] = iter(())  # Steps that end a take
        self._is_moving = False

    def start(self, names: Sequence[str], port: int) -> None:
        """Begin to receive a person for each name of an armature, empty for a person without one.

        Raises ``RequestError`` if ports can't be used, or bones are missing.
        """
        self._is_moving = False
        chosen = [name for name in names if name]
        if len(set(chosen)) < len(chosen):
            raise RequestError("Two people have the same armature. Choose another one.")
        armatures = [characters.find_armature(name) for name in names]
        for name, armature in zip(names, armatures, strict=True):
            if armature is not None:
                characters.check_bones(armature, characters.known_bones(armature))
            elif name:
                raise RequestError(f"The armature {name} is no longer there.")
        try:
            for number in range(len(names)):
                self.performers.append(_Performer(number + 1, port + number))
        except RequestError:
            self._close()
            raise
        for performer, armature in zip(self.performers, armatures, strict=True):
            if armature is not None:
                performer.take_armature(armature)
        panel_state().is_receiving = True
        bpy.app.timers.register(_tick, first_interval=_TICK_S, persistent=True)
        last = port + len(armatures) - 1
        ports = f"port {port}" if last == port else f"ports {port} to {last}"
        say(f"Blender waits for a live capture at {ports} of this machine.")

    def stop(self) -> None:
        """Stop receiving. A take ends, and is kept."""
        for _ in chain(self._ending, self._ended_take()):
            pass
        self._close()
        panel_state().is_receiving = False
        if bpy.app.timers.is_registered(_tick):
            bpy.app.timers.unregister(_tick)

    def _close(self) -> None:
        for performer in self.performers:
            performer.close()
        self.performers = []

    def step(self) -> bool:
        """Move the armatures; return whether it continues."""
        try:
            num_moved = sum([performer.step(self.take) for performer in self.performers])
        except RequestError as error:
            self.stop()
            say(str(error), is_error=True)
        else:
            if num_moved and not self._is_moving:
                self._is_moving = True
                names = [performer.armature for performer in self.performers if performer.armature]
                say(f"{', '.join(names)} {'move' if len(names) > 1 else 'moves'} as the people of the live capture.")
        redraw()
        return bool(self.performers)

    def record(self, name: str) -> None:
        """Begin a take, or end the one that runs."""
        if self.take is not None:
            self._ending = self._ended_take()
            do_steps(self._ending)
            return
        number = 1
        while any(action.name.startswith(f"{name} {number} ") for action in bpy.data.actions):
            number += 1
        self.take = LiveTake(f"{name} {number}", scene_rate_hz(bpy.context.scene), time.monotonic())
        say(f"{self.take.name} is recorded.")

    def _ended_take(self) -> Iterator[float]:
        take, self.take = self.take, None
        if take is None:
            return
        performers = {performer.number: performer for performer in self.performers}
        names, problems, num_frames, first_frame = [], [], 0, bpy.context.scene.frame_start
        for number, motion in take.motions(time.monotonic()):
            num_frames = motion.num_frames
            try:
                yield from performers[number].put_on(motion, take.name, first_frame)
                names.append(performers[number].armature)
            except RequestError as error:
                problems.append(str(error))
        if names:
            bpy.context.scene.frame_end = max(bpy.context.scene.frame_end, first_frame + num_frames - 1)
            bpy.ops.ed.undo_push(message=take.name)
        told = f"{take.name}: {num_frames} frames of {', '.join(names) or 'no person'}."
        say(" ".join([told, *problems]), is_error=bool(problems))


live = LiveReceiver()
"""Receiver of this Blender."""


def _tick() -> float | None:
    return _TICK_S if live.step() else None
