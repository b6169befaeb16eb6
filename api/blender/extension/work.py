"""Work that runs: one task in a thread at a time, and steps in Blender's main thread.

``pump``, a timer of Blender, takes results of tasks in and does the steps, so that Blender never waits.
"""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

from api.blender.extension.answers import JobEntry, RequestError
from api.blender.extension.client import BlenderClient, is_on_this_machine, service_address
from api.blender.extension.tasks import BackgroundTask

_PUMP_S = 0.1


class CurrentWork:
    """Task in a thread, what becomes of its result, and steps in the main thread."""

    def __init__(self) -> None:
        self.task: BackgroundTask | None = None
        self.then: Callable[[Any], None] | None = None
        self.steps: Iterator[float] | None = None
        self.folder: Path | None = None
        self.job: JobEntry | None = None

    @property
    def is_busy(self) -> bool:
        """True while anything runs."""
        return self.task is not None or self.steps is not None


current = CurrentWork()
"""Work that runs in this Blender."""


def panel_state(context: Any = None) -> Any:
    """Lists and choices of the panel."""
    return (context or bpy.context).window_manager.multicap


def extension_preferences(context: Any = None) -> Any:
    """Preferences of the extension."""
    return (context or bpy.context).preferences.addons[__package__].preferences


def service_client() -> BlenderClient:
    """Client of the service in the preferences. Raises ``RequestError`` for an address that is none."""
    preferences = extension_preferences()
    address = service_address(preferences.address)
    if not bpy.app.online_access and not is_on_this_machine(address):
        raise RequestError("Blender may not use the network. Allow online access: Preferences, System, Network.")
    return BlenderClient(address, preferences.key.strip())


def say(text: str, *, is_error: bool = False) -> None:
    """Show a message in the panel."""
    state = panel_state()
    state.message, state.is_error = text, is_error


def start(title: str, work: Callable[[BackgroundTask], Any], then: Callable[[Any], None]) -> None:
    """Start a task; ``then`` gets its result, in the main thread."""
    say("")
    current.task, current.then = BackgroundTask(title, work).start(), then
    _wake()


def do_steps(steps: Iterator[float]) -> None:
    """Do steps in the main thread, each a piece of work that takes little time."""
    current.steps = steps
    _wake()


def _wake() -> None:
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_PUMP_S, persistent=True)


def _tick() -> float | None:
    return _PUMP_S if pump() else None


def pump() -> bool:
    """Take in what was done, and do a step; return whether there is more to do."""
    try:
        if current.task is not None:
            _take_in(current.task)
        elif current.steps is not None:
            panel_state().fraction = next(current.steps)
    except StopIteration:
        current.steps = None
    except RequestError as error:
        current.steps = None
        say(str(error), is_error=True)
    if not current.is_busy:
        panel_state().fraction = -1.0
        _drop_folder()
    redraw()
    return current.is_busy


def _take_in(task: BackgroundTask) -> None:
    state = panel_state()
    state.fraction = -1.0 if task.fraction is None else task.fraction
    state.doing = f"{task.title}: {task.text}" if task.text else task.title
    if task.is_over:
        then, current.task, current.then = current.then, None, None
        if task.is_stopped:
            say("Stopped.")
        elif task.error:
            say(task.error, is_error=True)
        elif then is not None:
            then(task.result)


def redraw() -> None:
    """Have Blender draw its 3D views again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _drop_folder() -> None:
    if current.folder is not None:
        shutil.rmtree(current.folder, ignore_errors=True)
        current.folder = None


def end() -> None:
    """Stop what runs, for good."""
    if current.task is not None:
        current.task.stop()
    current.task = current.steps = None
    _drop_folder()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
