"""Operators: buttons of the panel."""

import tempfile
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy

from api.blender.extension import characters, scene
from api.blender.extension.answers import AwayError, CaptureEntry, FileEntry, JobEntry, RequestError
from api.blender.extension.capture_folder import find_capture
from api.blender.extension.characters import recognise, show_bones, stated_bones
from api.blender.extension.client import BlenderClient, CallerEntry, is_on_this_machine
from api.blender.extension.glb_motion import GlbFacts, check_glb, read_motion
from api.blender.extension.receiver import live
from api.blender.extension.retarget import armature_glb
from api.blender.extension.tasks import BackgroundTask, Speed
from api.blender.extension.work import current, do_steps, panel_state, say, service_client, start

# Importers of Blender, by the format of the service; the first one that a job has is taken.
_FORMATS = ("glb", "fbx")
_POLL_S = 2.0
_TAKE = "take.glb"


class _FreeOperator(bpy.types.Operator):
    """Operator that waits for nothing else that runs."""

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return not current.is_busy

    def execute(self, context: Any) -> set[str]:
        try:
            self.begin(context)
        except RequestError as error:
            say(str(error), is_error=True)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def begin(self, context: Any) -> None:
        raise NotImplementedError


class MulticapConnect(_FreeOperator):
    """Check the address and the key, and list the captures"""

    bl_idname, bl_label = "multicap.connect", "Connect"

    def begin(self, context: Any) -> None:
        client = service_client()
        state = panel_state(context)
        state.is_connected = False
        state.captures.clear()

        def work(_task: BackgroundTask) -> tuple[CallerEntry, tuple[list[CaptureEntry], str]]:
            return client.connect(), client.captures()

        def then(result: tuple[CallerEntry, tuple[list[CaptureEntry], str]]) -> None:
            caller, page = result
            state.tenant, state.may_write, state.is_connected = caller.tenant, caller.may_write, True
            _show_captures(page)
            if client.key and client.address.startswith("http:") and not is_on_this_machine(client.address):
                say("Connected. The key travels unencrypted: use https outside of networks that you trust.")

        start("Connect", work, then)


def _show_captures(page: tuple[list[CaptureEntry], str]) -> None:
    state = panel_state()
    captures, state.cursor = page
    for capture in captures:
        item = state.captures.add()
        item.ident = capture.id
        item.label = f"{capture.name} - {capture.created_at}, {capture.duration_s:.0f} s"
    if not state.captures:
        say("There are no captures of this name." if state.search else "There are no captures yet. Send one below.")


class MulticapRefresh(_FreeOperator):
    """List the captures again"""

    bl_idname, bl_label = "multicap.refresh", "List captures"

    is_next: bpy.props.BoolProperty(description="Add the next page to the list", options={"SKIP_SAVE"})

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        search, cursor = state.search, state.cursor if self.is_next else ""
        if not self.is_next:
            state.captures.clear()
            state.capture = 0
        start("List captures", lambda _task: client.captures(search, cursor), _show_captures)


def _chosen_armature(context: Any) -> Any:
    armature = characters.find_armature(panel_state(context).armature)
    if armature is None:
        raise RequestError("Choose an armature of the scene.")
    return armature


def _chosen(items: Any, number: int, what: str) -> Any:
    if 0 <= number < len(items):
        return items[number]
    raise RequestError(f"Choose a {what} first.")


class MulticapJobs(_FreeOperator):
    """List the jobs of the chosen capture"""

    bl_idname, bl_label = "multicap.jobs", "Show jobs"

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        ident = _chosen(state.captures, state.capture, "capture").ident
        start("List jobs", lambda _task: client.jobs(ident), _show_jobs)


def _show_jobs(jobs: Sequence[JobEntry]) -> None:
    state = panel_state()
    state.jobs.clear()
    state.job = 0
    for job in jobs:
        item = state.jobs.add()
        item.ident, item.label = job.id, f"{job.created_at}, {job.sentence()}"
    if not jobs:
        say("This capture was not reconstructed yet.")


class MulticapPeople(_FreeOperator):
    """List the people of the chosen job; follow a job that still runs"""

    bl_idname, bl_label = "multicap.people", "Show people"

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        ident = _chosen(state.jobs, state.job, "job").ident
        start("Job", lambda task: _followed(client, ident, task), _show_people)


def _followed(client: BlenderClient, ident: str, task: BackgroundTask) -> tuple[JobEntry, list[FileEntry]]:
    """Wait in the thread until a job has ended; return it and its files."""
    while True:
        try:
            job = client.job(ident)
        except AwayError as error:
            task.report(task.fraction, f"{error} It is tried again.")
        else:
            task.report(job.progress, job.sentence())
            if job.is_over:
                break
        task.sleep(_POLL_S)
    if job.state != "succeeded":
        raise RequestError(f"The job {job.state}. {job.error}".strip())
    return job, client.files(ident)


def _show_people(result: tuple[JobEntry, list[FileEntry]]) -> None:
    state = panel_state()
    job, files = result
    current.job = job
    people = _person_files(files)
    state.people.clear()
    for number, file in enumerate(people):
        item = state.people.add()
        item.label, item.number, item.is_person = file.person, number, True
    if not people:
        say("The job has no GLB and no FBX of people. Reconstruct the capture again with GLB.", is_error=True)


def _person_files(files: Sequence[FileEntry]) -> list[FileEntry]:
    """Files of people in the first format that there is, in the order of the service."""
    for form in _FORMATS:
        found = [file for file in files if file.person and file.format == form]
        if found:
            return found
    return []


def _download(
    client: BlenderClient,
    job: JobEntry,
    numbers: Sequence[int],
    task: BackgroundTask,
    folder: Path,
    *,
    has_cameras: bool,
) -> tuple[list[tuple[str, Path]], Path | None, GlbFacts | None]:
    """Download in the thread the files of some people, and the take's file; return names, paths, and the timeline."""
    files = client.files(job.id)
    people = [file for number, file in enumerate(_person_files(files)) if number in numbers]
    takes = [file for file in files if file.name == _TAKE] if has_cameras else []
    if has_cameras and not takes:
        raise RequestError("The job has no take.glb with the cameras. Reconstruct with GLB, or import without cameras.")
    wanted = [*people, *takes]
    speed, done, paths = Speed(sum(file.num_bytes for file in wanted)), 0, []
    for number, file in enumerate(wanted):
        # Paths have our own names: a service may send any name.
        path = folder / f"{number}.{'fbx' if file.format == 'fbx' else 'glb'}"

        def watch(there: float, before: int = done) -> None:
            task.report(speed.fraction(before + there), speed.text(before + there))

        client.download(job.id, file, path, watch)
        done += file.num_bytes
        paths.append(path)
    facts = [check_glb(path) for path in paths if path.suffix == ".glb"]
    named = [(file.person, path) for file, path in zip(people, paths, strict=False)]
    return named, paths[-1] if takes else None, facts[0] if facts else _read_timeline(client, job)


def _read_timeline(client: BlenderClient, job: JobEntry) -> GlbFacts | None:
    """Timeline of a job without GLB files."""
    timeline = client.timeline(job.id)
    return None if timeline is None else GlbFacts(*timeline)


def _selected(state: Any) -> tuple[JobEntry, list[int]]:
    numbers = [person.number for person in state.people if person.is_chosen]
    if current.job is None or not state.people:
        raise RequestError("Choose a job and show its people first.")
    return current.job, numbers


class MulticapImport(_FreeOperator):
    """Import the chosen people: skeleton, body and motion, an armature for each"""

    bl_idname, bl_label, bl_options = "multicap.import_people", "Import people", {"UNDO"}

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        job, numbers = _selected(state)
        has_cameras, has_timeline = state.has_cameras, state.has_timeline
        if not numbers and not has_cameras:
            raise RequestError("Choose a person to import.")
        folder = current.folder = Path(tempfile.mkdtemp(prefix="multicap-"))

        def then(result: tuple[list[tuple[str, Path]], Path | None, GlbFacts | None]) -> None:
            do_steps(_imported(job.capture_name, *result, has_timeline=has_timeline))

        start(
            "Download",
            lambda task: _download(client, job, numbers, task, folder, has_cameras=has_cameras),
            then,
        )


def _imported(
    name: str, people: Sequence[tuple[str, Path]], take: Path | None, facts: GlbFacts | None, *, has_timeline: bool
) -> Iterator[float]:
    state = panel_state()
    target = bpy.context.scene
    if facts is not None and has_timeline:
        scene.set_timeline(target, facts)
    collection = scene.add_collection(target, name)
    num_parts = len(people) + (take is not None)
    for number, (person, path) in enumerate(people):
        state.doing = f"Import {person}"
        yield number / num_parts
        scene.import_person(path, person, collection)
    num_cameras = 0
    if take is not None:
        state.doing = "Import cameras"
        yield len(people) / num_parts
        num_cameras = len(scene.import_cameras(take, collection))
    words = [f"{len(people)} {'person' if len(people) == 1 else 'people'}"] if people else []
    say(f"Imported {' and '.join([*words, *([f'{num_cameras} cameras'] if take is not None else [])])}.")


class MulticapRecognise(_FreeOperator):
    """Recognise the bones of the armature by their names again; changes of the list are lost"""

    bl_idname, bl_label = "multicap.recognise", "Recognise bones"

    def begin(self, context: Any) -> None:
        _chosen_armature(context)
        recognise(panel_state(context))


class MulticapAskForBones(_FreeOperator):
    """Have the service recognise the bones that the list lacks, by the shape of the armature if names tell nothing"""

    bl_idname, bl_label = "multicap.ask_for_bones", "Ask the service"

    def begin(self, context: Any) -> None:
        client, stated = service_client(), stated_bones(panel_state(context))
        armature = _chosen_armature(context)
        name, content = armature.name, armature_glb(characters.read_rest(armature))

        def then(bones: dict[str, str]) -> None:
            state = panel_state()
            if state.armature != name or characters.find_armature(name) is None:
                raise RequestError(f"The armature {name} is no longer chosen.")
            show_bones(state, bones)

        start("Recognise bones", lambda _task: client.recognised_bones(content, stated), then)


class MulticapPutOn(_FreeOperator):
    """Put the motion of the first chosen person on the armature, as a new action"""

    bl_idname, bl_label, bl_options = "multicap.put_on", "Put motion on armature", {"UNDO"}

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        job, numbers = _selected(state)
        armature, has_timeline = _chosen_armature(context), state.has_timeline
        if len(numbers) != 1:
            raise RequestError("Choose one person whose motion the armature gets.")
        characters.check_bones(armature, characters.known_bones(armature))
        folder, name = Path(tempfile.mkdtemp(prefix="multicap-")), armature.name
        current.folder = folder

        def work(task: BackgroundTask) -> tuple[str, Any]:
            ((person, path),), _take, _facts = _download(client, job, numbers, task, folder, has_cameras=False)
            if path.suffix != ".glb":
                raise RequestError("The job has no GLB of the person. Reconstruct the capture again with GLB.")
            task.report(None, "read the motion")
            return person, read_motion(path)

        def then(result: tuple[str, Any]) -> None:
            do_steps(_put(name, *result, has_timeline=has_timeline))

        start("Download", work, then)


def _put(name: str, person: str, motion: Any, *, has_timeline: bool) -> Iterator[float]:
    armature = characters.find_armature(name)
    if armature is None:
        raise RequestError(f"The armature {name} is no longer there.")
    bones = characters.known_bones(armature)
    panel_state().doing = f"Put the motion of {person} on {name}"
    if has_timeline:
        scene.set_timeline(bpy.context.scene, GlbFacts(motion.frame_rate_hz, motion.num_frames))
    yield from characters.put_on(armature, motion, person)
    pulled = characters.constrained(armature, list(bones.values()))
    text = f"{name} moves as {person}."
    say(f"{text} Constraints still pull {', '.join(pulled[:5])}: mute them." if pulled else text, is_error=bool(pulled))


class MulticapReceive(_FreeOperator):
    """Move armatures like the people that a live capture sends to the ports (VMC), or stop; takes stay as actions"""

    bl_idname, bl_label = "multicap.receive", "Receive live"

    def begin(self, context: Any) -> None:
        state = panel_state(context)
        if state.is_receiving:
            say("Nothing is received any more.")
            live.stop()
        else:
            live.start([getattr(state, f"live_{number + 1}") for number in range(state.live_people)], state.live_port)

    @classmethod
    def poll(cls, context: Any) -> bool:
        return panel_state(context).is_receiving or super().poll(context)


class MulticapRecord(_FreeOperator):
    """Record the people who are received as actions of their armatures, or end the take that is recorded"""

    bl_idname, bl_label = "multicap.record", "Record take"

    def begin(self, context: Any) -> None:
        live.record(panel_state(context).take.strip() or "Take")

    @classmethod
    def poll(cls, context: Any) -> bool:
        return panel_state(context).is_receiving and super().poll(context)


class MulticapSend(_FreeOperator):
    """Send the videos of a folder with a calibration as a new capture, and reconstruct it"""

    bl_idname, bl_label = "multicap.send", "Send and reconstruct"

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        folder, calibration = (
            Path(bpy.path.abspath(text)) if text else None for text in (state.folder, state.calibration)
        )
        if folder is None:
            raise RequestError("Choose the folder with the videos.")
        files = find_capture(folder, calibration)
        name = state.name.strip() or folder.name or "Capture"
        spec: dict[str, Any] = {"exports": ["glb"], **({"body": "human"} if state.has_human else {})}

        def work(task: BackgroundTask) -> tuple[JobEntry, list[FileEntry]]:
            speed = Speed(files.num_bytes)

            def watch(sent: float) -> None:
                is_sent = sent >= files.num_bytes
                task.report(speed.fraction(sent), "the service checks the files" if is_sent else speed.text(sent))

            job = client.send(name, files.videos, files.calibration, spec, watch)
            return _followed(client, job.id, task)

        def then(result: tuple[JobEntry, list[FileEntry]]) -> None:
            _show_jobs([result[0]])
            _show_people(result)
            say(f"{name} is reconstructed: import its people.")

        start("Send", work, then)


class MulticapStop(bpy.types.Operator):
    """Stop what runs. A job that was sent continues in the service"""

    bl_idname, bl_label = "multicap.stop", "Stop"

    def execute(self, _context: Any) -> set[str]:
        if current.task is not None:
            current.task.stop()
        if current.steps is not None:
            current.steps = None
            say("Stopped.")
        return {"FINISHED"}


class MulticapCancelJob(_FreeOperator):
    """Cancel the chosen job in the service"""

    bl_idname, bl_label = "multicap.cancel_job", "Cancel job"

    def begin(self, context: Any) -> None:
        client, state = service_client(), panel_state(context)
        ident, capture = (
            _chosen(state.jobs, state.job, "job").ident,
            _chosen(state.captures, state.capture, "capture").ident if state.captures else "",
        )

        def work(_task: BackgroundTask) -> list[JobEntry]:
            client.cancel(ident)
            return client.jobs(capture) if capture else [client.job(ident)]

        start("Cancel", work, _show_jobs)


class MulticapOpenPage(bpy.types.Operator):
    """Open the page of the chosen job, or of the captures, in the browser"""

    bl_idname, bl_label = "multicap.open_page", "Open in browser"

    def execute(self, context: Any) -> set[str]:
        state = panel_state(context)
        try:
            client = service_client()
            webbrowser.open(
                client.page_address(state.jobs[state.job].ident if 0 <= state.job < len(state.jobs) else "")
            )
        except RequestError as error:
            say(str(error), is_error=True)
            return {"CANCELLED"}
        return {"FINISHED"}


OPERATORS = (
    MulticapConnect,
    MulticapRefresh,
    MulticapJobs,
    MulticapPeople,
    MulticapImport,
    MulticapRecognise,
    MulticapAskForBones,
    MulticapPutOn,
    MulticapReceive,
    MulticapRecord,
    MulticapSend,
    MulticapStop,
    MulticapCancelJob,
    MulticapOpenPage,
)
"""Classes to register."""
