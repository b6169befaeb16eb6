"""Parameters of the Qualisys real-time protocol as XML: general settings, labels of 3D markers, skeletons.

People are skeletons with the names ``person-1`` and so on, and their joints are labelled markers. Segments have the
names of Qualisys' skeletons; in the rest pose their axes are the world's, and the person faces +Y. Lengths are in
millimetres.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from pipeline.motion.skeleton.model import find_skeleton, parent_indices, rest_offsets_m
from pipeline.run.live.outputs.poses import FACING_Y, in_segments, person_colour, person_name, rest_joints_m
from pipeline.run.live.records import LiveInstant, LiveSkeleton

_MAX_LISTED = 32
# From this minor version on the element of a segment has its child segments.
_FIRST_HIERARCHICAL = 21
# Names of segments that differ from the names of our joints; other ends of bones are no segments.
_SEGMENT_NAMES = {"Chest": "Spine1", "LeftFootEnd": "LeftToeBase", "RightFootEnd": "RightToeBase"}


def segment_joints(num_joints: int) -> list[int]:
    """Joints that are segments, in the order of the segments' numbers."""
    names = [joint.name for joint in find_skeleton(num_joints)]
    return [place for place, name in enumerate(names) if name in _SEGMENT_NAMES or not name.endswith("End")]


_ACTIONS = (
    *("PreProcessing2D", "TwinSystemMerge", "SplineFill", "AIM", "Track6DOF", "ForceData", "GazeVector"),
    *("EyeTracker", "SkeletonSolve", "ExportTSV", "ExportC3D", "ExportMatlabFile", "ExportAviFile"),
)


def _general(rate_hz: float, *_: object) -> Element:
    # Elements that clients demand; actions of processing, triggers and external clocks do not exist here.
    root = Element("General")
    _add(root, Frequency=round(rate_hz), Capture_Time="0.0", Start_On_External_Trigger="False")
    _add(root, **dict.fromkeys(("Start_On_Trigger_NO", "Start_On_Trigger_NC", "Start_On_Trigger_Software"), "False"))
    clock = {"Enabled": "False", "Signal_Source": "Control port", "Signal_Mode": "Periodic", "Signal_Edge": "Negative"}
    clock |= {"Frequency_Multiplier": "1", "Frequency_Divisor": "1", "Frequency_Tolerance": "1000"}
    clock |= {"Nominal_Frequency": "None", "Signal_Shutter_Delay": "0", "Non_Periodic_Timeout": "0.0"}
    _add(SubElement(root, "External_Time_Base"), **clock)
    for name in ("Processing_Actions", "RealTime_Processing_Actions", "Reprocessing_Actions"):
        _add(SubElement(root, name), Tracking="3D", **dict.fromkeys(_ACTIONS, "False"))
    return root


def _three_d(_: float, joints: Sequence[str], skeletons: Mapping[int, LiveSkeleton]) -> Element:
    root = Element("The_3D")
    _add(root, AxisUpwards="+Z", CalibrationTime="unknown", Labels=len(joints) * len(skeletons))
    for number in skeletons:
        red, green, blue = person_colour(number)
        for joint in joints:
            label = SubElement(root, "Label")
            _add(label, Name=f"{person_name(number)}_{joint}", RGBColor=red + 256 * green + 65536 * blue)
            _add(label, Trajectory_Type="Measured")
    SubElement(root, "Bones")
    return root


def _skeletons(is_global: bool, skeletons: Mapping[int, LiveSkeleton]) -> Element:
    root = Element("Skeletons")
    for number, skeleton in skeletons.items():
        body = SubElement(root, "Skeleton", Name=person_name(number))
        _add(body, Scale="1.0")
        places = segment_joints(len(skeleton.bone_length_m))
        joints, parents = find_skeleton(len(skeleton.bone_length_m)), parent_indices(len(skeleton.bone_length_m))
        rest_m = rest_joints_m(skeleton.bone_length_m)
        if not is_global:
            rest_m[1:] = rest_offsets_m(skeleton.bone_length_m)[1:]
        rest_mm = 1e3 * in_segments(rest_m, FACING_Y)
        elements = {0: SubElement(body, "Segments")}
        for segment_number, place in enumerate(places, 1):
            name = joints[place].name
            above = elements[int(parents[place])] if place else elements[0]
            segment = SubElement(above, "Segment", Name=_SEGMENT_NAMES.get(name, name), ID=str(segment_number))
            _add(segment, Solver="Global Optimization")
            for kind in ("Transform", "DefaultTransform"):
                transform = SubElement(segment, kind)
                position = {axis: f"{value:.4f}" for axis, value in zip("XYZ", rest_mm[place], strict=True)}
                SubElement(transform, "Position", position)
                SubElement(transform, "Rotation", X="0", Y="0", Z="0", W="1")
            elements[place] = segment
    return root


def _add(parent: Element, **values: object) -> None:
    for name, value in values.items():
        SubElement(parent, name).text = str(value)


_SECTIONS: Mapping[str, Callable[[float, Sequence[str], Mapping[int, LiveSkeleton]], Element]] = MappingProxyType(
    {
        "general": _general,
        "3d": _three_d,
        "skeleton": lambda _rate, _joints, skeletons: _skeletons(False, skeletons),
        "skeleton:global": lambda _rate, _joints, skeletons: _skeletons(True, skeletons),
    }
)
_ALL = ("general", "3d", "skeleton")
_EMPTY_SECTIONS = {"6d", "analog", "force", "gazevector", "eyetracker", "image", "calibration"}


class ParameterError(Exception):
    """Parameters that don't exist."""


class Parameters:
    """Parameters of a capture; ``rate_hz`` and ``joints`` are of its instants. Texts are kept until people change."""

    def __init__(self, rate_hz: float, joints: Sequence[str]) -> None:
        self._rate_hz, self._joints = rate_hz, joints
        self._texts: dict[str, str] = {}
        self._seen_s: dict[int, float] = {}
        # Latest pose by the person's number, in the order of appearance; who left long ago makes room for others.
        self.skeletons: dict[int, LiveSkeleton] = {}

    def update(self, instant: LiveInstant) -> bool:
        """Take an instant; return whether there are people who were not listed before."""
        is_changed = False
        for person in instant.people:
            if person.skeleton is None:
                continue
            known = self.skeletons.get(person.id)
            if known is None and len(self.skeletons) == _MAX_LISTED:
                gone = min(self._seen_s, key=self._seen_s.__getitem__)
                del self.skeletons[gone], self._seen_s[gone]
            if known is None or not np.array_equal(known.bone_length_m, person.skeleton.bone_length_m):
                self._texts.clear()
            is_changed |= known is None
            self.skeletons[person.id], self._seen_s[person.id] = person.skeleton, instant.time_s
        return is_changed

    def read(self, names: Iterable[str], version: int) -> tuple[str, set[str]]:
        """XML of the parameters that are named, for a minor version, and the names of the parameters that list people.

        Raises ``ParameterError``.
        """
        wanted = {part for name in names for part in (_ALL if name == "all" else (name,))}
        if not wanted or wanted - _SECTIONS.keys() - _EMPTY_SECTIONS:
            raise ParameterError("Parse error")
        if version < _FIRST_HIERARCHICAL and wanted & {"skeleton", "skeleton:global"}:
            raise ParameterError(f"Skeletons need version 1.{_FIRST_HIERARCHICAL} or later")
        wanted &= _SECTIONS.keys()
        for name in wanted - self._texts.keys():
            section = _SECTIONS[name](self._rate_hz, self._joints, self.skeletons)
            self._texts[name] = tostring(section, encoding="unicode")
        root = f"QTM_Parameters_Ver_1.{version}"
        text = "".join(self._texts[name] for name in _SECTIONS if name in wanted)
        return f"<{root}>{text}</{root}>", {name.partition(":")[0] for name in wanted - {"general"}}
