"""Correct a person's motion: frames around corrections are fitted again, and passed to the uncorrected motion.

1. Where observations changed, the person is fitted to them, with the proportions that are known. The fit has a second
   more on both sides, and is blended into the uncorrected motion over half a second.
2. Contacts are those found in the changed frames, with contacts that were added and without removed ones.
3. The skeleton is posed to the blended joints once more, with keyed joints and standing feet held exactly.

Each range of corrections is computed by itself, so that their order does not matter. Frames more than half a second
from all corrections keep every bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from pipeline.core.data.animation import Floor, FootContact, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import MARKED_AT_CENTERS, JointSet, without_hands
from pipeline.core.options.edits import Contact, Correction, Limb, frames_of
from pipeline.geometry.tracks import reproject
from pipeline.motion.skeleton.animate import PersonFitter
from pipeline.motion.skeleton.corrections import keys as keying
from pipeline.motion.skeleton.corrections import poses, stances
from pipeline.motion.skeleton.corrections.evidence import CorrectedEvidence
from pipeline.motion.skeleton.feet.floor import SIDES, find_runs
from pipeline.motion.skeleton.feet.stances import FootPoints, foot_contacts, foot_points, mean_slide_m
from pipeline.motion.skeleton.feet.unseen import foot_without_toes
from pipeline.motion.skeleton.fitting.fit import SkeletonFit, fit_to_rays
from pipeline.motion.skeleton.fitting.positions import usual_step_m
from pipeline.motion.skeleton.hands import whole
from pipeline.motion.skeleton.marks import has_torso, marks_from_centers
from pipeline.motion.skeleton.model import INDEX, SKELETON

# Time that a fit begins before and ends after the frames that it changes.
_MARGIN_S = 1.0
# Time over which the exact poses pass to the uncorrected ones, at the ends of the changed frames.
_SEAM_S = 0.15
# Joints are led to their places in parts of this length, as a step of the fit is only good for a short way, with this
# standard deviation and number of steps each; and with these at the places. The damping lets straight limbs bend.
_WAY_M, _LED_M, _NUM_STEPS = 0.05, 0.002, 3
_EXACT_M, _NUM_EXACT_STEPS = 0.0002, 6
_DAMPING = 3000.0
# Joints whose observations tell where feet stand.
_LEGS = ("hip", "knee", "ankle", "heel", "toe")
_ON_FOOT = ("ankle", "heel", "big_toe")
# Displacement from which on a keyed foot stands no longer where it did.
_LIFTED_M = 0.01


def correct_person(
    fitter: PersonFitter,
    track: Track3D,
    motion: SkeletonMotion,
    evidence: CorrectedEvidence,
    corrections: Sequence[Correction],
    floor: Floor | None,
) -> tuple[Track3D, SkeletonMotion]:
    """Correct the final track and motion of a person.

    Keyed joints are at their places, but for places that the skeleton cannot reach: it comes as near as it can. Keys of
    fingers and of joints that the skeleton does not carry change nothing, and neither do corrections of a person
    without hips and shoulders, whose skeleton has no place.

    - ``fitter``: fit with which the person was animated.
    - ``track``, ``motion``: person without corrections; positions in metres, NaN where a joint is unknown.
    - ``evidence``: located joints and observations after the corrections, see ``corrected_evidence``.
    - ``corrections``: corrections of the person, in output frames.
    - ``floor``: floor of the take; ``None``: there is none.

    Returns the track and motion. Frames half a second and more from all corrections are as they were. A joint is known,
    as a prediction, where a key moves it. Standard deviations are 1 cm at keys, and grow with the time to them.
    """
    joints = without_hands(fitter.joints)
    body, _ = whole.selected(track, evidence.seen, fitter.joints, joints.names)
    if not has_torso(body.xyz_m, joints):
        return track, motion
    person = _Person(fitter, body, joints, track, motion, evidence, corrections, floor)
    for start, stop in find_runs(person.away < person.reach):
        person.correct(slice(start, stop))
    return person.corrected()


class _Person:
    """A person: arrays of the whole take, in which ranges of frames are corrected one by one."""

    def __init__(
        self,
        fitter: PersonFitter,
        body: Track3D,
        joints: JointSet,
        track: Track3D,
        motion: SkeletonMotion,
        evidence: CorrectedEvidence,
        corrections: Sequence[Correction],
        floor: Floor | None,
    ) -> None:
        self._fitter, self._body, self._joints, self._track = fitter, body, joints, track
        self._evidence, self._corrections, self._floor = evidence, corrections, floor
        self._whole_motion, self._motion = motion, poses.body_of(motion)
        self._rate_hz, num_frames = motion.frame_rate_hz, track.num_frames
        self._known = poses.known_proportions(body, self._motion, joints)
        carried = self._skeleton(body).carried
        keys = keying.keys_by_joint(corrections, track.start_frame, num_frames)
        self._keys = {name: keys[name] for name in joints.names if name in keys and name in carried}
        self._stands = stances.added_contacts(corrections, track.start_frame, num_frames)
        is_touched = np.array(evidence.is_changed.any(1))
        self._away_from_seen = _distance(is_touched)
        for of_joint in self._keys.values():
            is_touched[list(of_joint)] = True
        for correction in corrections:
            if isinstance(correction, Contact):
                is_touched[keying.rows_between(*frames_of(correction), track.start_frame, num_frames)] = True
        self.away, self.reach = _distance(is_touched), keying.reach_frames(self._rate_hz)
        self._root_m, self._quat = np.array(motion.root_m), np.array(motion.parent_from_joint)
        self._contacts = motion.contacts
        self._arrays = {name: np.array(array) for name, array in track.joint_arrays.items()}

    def corrected(self) -> tuple[Track3D, SkeletonMotion]:
        """Track and motion after ``correct``."""
        arrays: dict[str, Any] = {name: read_only(array) for name, array in self._arrays.items()}
        root_m, quat = read_only(self._root_m), read_only(poses.continued(self._quat))
        motion = replace(self._whole_motion, root_m=root_m, parent_from_joint=quat, contacts=self._contacts)
        return replace(self._track, **arrays), motion

    def correct(self, changed: slice) -> None:
        """Correct a range of frames."""
        margin = round(_MARGIN_S * self._rate_hz)
        rows = slice(max(changed.start - margin, 0), min(changed.stop + margin, len(self.away)))
        here = slice(changed.start - rows.start, changed.stop - rows.start)
        before = poses.rows_of(self._whole_motion, rows)
        is_changed = self.away[rows] < self.reach
        is_changed[: here.start] = is_changed[here.stop :] = False  # other ranges
        share = _rising(1.0 - self._away_from_seen[rows] / self.reach) * is_changed
        fresh = self._refit(rows) if share.any() else None

        fit = self._skeleton(self._body.part(rows))
        fit.set_pose(before.root_m, before.parent_from_joint[:, : len(SKELETON)])
        feet, blended = foot_points(fit, poses.body_of(before), self._joints), before
        if fresh is not None:
            blended = poses.blended(before, fresh.motion, share)
            fit.set_pose(blended.root_m, blended.parent_from_joint[:, : len(SKELETON)])
        target_m = poses.posed_m(fit)
        moved_m = self._displacements_m(rows, target_m, is_changed)
        self._find_contacts(rows, feet, fresh, share, moved_m)
        contacts = stances.clipped(self._contacts, rows)
        points = foot_points(fit, poses.body_of(blended), self._joints)
        places_m = dict(
            stances.held_feet_m(feet, points, contacts, self._stands_in(rows), is_changed, self._floor, self._rate_hz)
        )
        wrists_m = {name: target_m[:, self._joints.index(name)] for name in self._joints.names if "wrist" in name}
        places_m |= stances.held_hands_m(wrists_m, self._stands_in(rows), self._rate_hz)
        for name, by_m in moved_m.items():
            is_keyed = np.isfinite(by_m).all(-1, keepdims=True)
            side, _, kind = name.partition("_")
            if kind in _ON_FOOT:
                for other in (f"{side}_{kind}" for kind in _ON_FOOT):
                    if other in places_m:
                        places_m[other] = np.where(is_keyed, np.nan, places_m[other])
            keyed_m = target_m[:, self._joints.index(name)] + by_m
            places_m[name] = np.where(is_keyed, keyed_m, places_m.get(name, np.nan))
        exact = self._posed_exactly(changed, here, blended, target_m, places_m)
        if not fit.sees_feet:
            exact = self._with_feet(exact, contacts, points)
        exact = poses.with_hands_in_world(exact, blended)
        seam = _rising((self.reach - self.away[rows]) / max(round(_SEAM_S * self._rate_hz), 1)) * is_changed
        after = poses.blended(before, exact, seam)
        self._root_m[changed], self._quat[changed] = after.root_m[here], after.parent_from_joint[here]
        fit.set_pose(after.root_m, after.parent_from_joint[:, : len(SKELETON)])
        self._measure_slides(rows, points, foot_points(fit, poses.body_of(after), self._joints), is_changed)
        self._take_joints(rows, here, before, after, fresh, moved_m, share)

    def _skeleton(self, body: Track3D) -> SkeletonFit:
        return SkeletonFit(body, self._joints, self._fitter.timebase, self._motion.name, known=self._known)

    def _refit(self, rows: slice) -> "_Fresh | None":
        """Fit a range of frames to the corrected observations, with free feet; ``None`` without any torso."""
        fitter, located = self._fitter, self._evidence.located.part(rows)
        seen = self._evidence.weighted.part(rows)
        body, of_body = whole.selected(located, seen, fitter.joints, self._joints.names)
        if not has_torso(body.xyz_m, self._joints):
            return None
        offsets = fitter.offsets if fitter.config.smoothing == "fit" else MARKED_AT_CENTERS
        fit = fit_to_rays(
            body, of_body, fitter.cameras, fitter.timebase, self._joints, "", offsets, proportions=self._known
        )
        motion = fit.motion()
        points = foot_points(fit, motion, self._joints)
        if whole.has_fingers(fitter.joints):
            views = whole.views_of_hands(located, seen, fitter.joints, self._rate_hz)
            length_m = self._whole_motion.bone_length_m
            motion = whole.with_hands(
                motion, whole.fit_hands(motion, located, views, fitter.joints, fitter.cameras, length_m)
            )
        return _Fresh(fit.track, motion, points, fit.uncertainty_m)

    def _find_contacts(
        self,
        rows: slice,
        feet: FootPoints,
        fresh: "_Fresh | None",
        share: Float[np.ndarray, " frames"],
        moved_m: Mapping[str, Float[np.ndarray, "frames 3"]],
    ) -> None:
        """Find contacts again where observations of legs changed; end them where keys move feet, add and remove."""
        found: tuple[FootContact, ...] = ()
        is_found = np.zeros(len(self.away), bool)
        on_legs = [number for number, name in enumerate(self._fitter.joints.names) if name.endswith(_LEGS)]
        if fresh is not None and self._evidence.is_changed[rows][share == 1.0][:, on_legs].any():
            is_found[rows] = share >= 0.5
            found = foot_contacts(fresh.points, self._floor, self._rate_hz, self._fitter.config.feet)
            found = tuple(replace(contact, start_frame=contact.start_frame + rows.start) for contact in found)
        first = self._track.start_frame + rows.start
        limbs: tuple[Limb, Limb] = ("left_foot", "right_foot")
        lifted = [
            Contact(person=0, limb=limb, start_frame=first + start, stop_frame=first + stop, stands=False)
            for side, limb in zip(SIDES, limbs, strict=True)
            for kind in _ON_FOOT
            if (by_m := moved_m.get(f"{side}_{kind}")) is not None
            for start, stop in find_runs(np.linalg.norm(by_m, axis=-1) > _LIFTED_M)
        ]
        corrections = [*lifted, *(c for c in self._corrections if isinstance(c, Contact))]
        self._contacts = stances.contacts_between(
            self._contacts, found, is_found, corrections, self._track.start_frame, feet.by_parts, self._rate_hz
        )

    def _stands_in(self, rows: slice) -> Mapping[str, Bool[np.ndarray, " frames"]]:
        return {limb: stands[rows] for limb, stands in self._stands.items()}

    def _displacements_m(
        self, rows: slice, target_m: Float[np.ndarray, "frames joints 3"], is_changed: Bool[np.ndarray, " frames"]
    ) -> Mapping[str, Float[np.ndarray, "frames 3"]]:
        """Displacements of keyed joints in metres, NaN where a joint is free."""
        moved_m = {}
        for name, of_joint in self._keys.items():
            joint_m = target_m[:, self._joints.index(name)]
            ways_m = {row - rows.start: of_joint[row] for row in sorted(of_joint) if rows.start <= row < rows.stop}
            ways_m = {row: place_m - joint_m[row] for row, place_m in ways_m.items() if is_changed[row]}
            if ways_m:
                source = self._evidence.located.source[rows, self._fitter.joints.index(name)]
                is_measured = source == Source.MEASURED
                moved_m[name] = keying.displacement_m(
                    list(ways_m), np.array(list(ways_m.values())), is_measured, self._rate_hz
                )
        return moved_m

    def _posed_exactly(
        self,
        changed: slice,
        here: slice,
        blended: SkeletonMotion,
        target_m: Float[np.ndarray, "frames joints 3"],
        places_m: Mapping[str, Float[np.ndarray, "frames 3"]],
    ) -> SkeletonMotion:
        """Pose the skeleton to joints in changed frames, with some held at places; NaN where they are free."""
        places_m = {name: place_m[here] for name, place_m in places_m.items() if np.isfinite(place_m[here]).any()}
        if not places_m:
            return blended
        body, target_m = self._body.part(changed), target_m[here]
        fit = self._skeleton(replace(body, xyz_m=target_m, source=np.full_like(body.source, Source.MEASURED)))
        fit.set_pose(blended.root_m[here], blended.parent_from_joint[here, : len(SKELETON)])
        ways_m = {name: place_m - target_m[:, self._joints.index(name)] for name, place_m in places_m.items()}
        longest_m = max(float(np.nanmax(np.abs(way_m))) for way_m in ways_m.values())
        num_parts = max(int(np.ceil(longest_m / _WAY_M)), 1)
        for number in range(num_parts):
            rest = 1.0 - (number + 1) / num_parts
            led_m = {name: place_m - rest * ways_m[name] for name, place_m in places_m.items()}
            fit.pin(led_m, sigma_m=_LED_M, num_steps=_NUM_STEPS, damping=_DAMPING)
        fit.pin(places_m, sigma_m=_EXACT_M, num_steps=_NUM_EXACT_STEPS, damping=_DAMPING)
        root_m, quat = np.array(blended.root_m), np.array(blended.parent_from_joint)
        root_m[here], quat[here, : len(SKELETON)] = fit.current.root_m, fit.current.parent_from_joint
        return replace(blended, root_m=root_m, parent_from_joint=quat)

    def _with_feet(
        self, motion: SkeletonMotion, contacts: tuple[FootContact, ...], points: FootPoints
    ) -> SkeletonMotion:
        """Turn feet of which only the ankles are known."""
        quat = np.array(motion.parent_from_joint)
        for side in SIDES:
            standing = replace(poses.body_of(motion), contacts=contacts)
            turned = foot_without_toes(standing, side, points.support, self._floor)
            quat[:, INDEX[f"{side.capitalize()}Foot"]] = turned.as_quat()
        return replace(motion, parent_from_joint=quat)

    def _measure_slides(
        self, rows: slice, before: FootPoints, after: FootPoints, is_changed: Bool[np.ndarray, " frames"]
    ) -> None:
        """Measure the slides of contacts in changed frames, before and after feet are held."""
        measured = []
        for contact in self._contacts:
            slides_m = contact.slide_before_m, contact.slide_after_m
            for part in stances.clipped([contact], rows):
                if is_changed[part.rows].any():
                    slides_m = mean_slide_m(before.point_m(part)), mean_slide_m(after.point_m(part))
            measured.append(replace(contact, slide_before_m=slides_m[0], slide_after_m=slides_m[1]))
        self._contacts = tuple(measured)

    def _take_joints(
        self,
        rows: slice,
        here: slice,
        before: SkeletonMotion,
        after: SkeletonMotion,
        fresh: "_Fresh | None",
        moved_m: Mapping[str, Float[np.ndarray, "frames 3"]],
        share: Float[np.ndarray, " frames"],
    ) -> None:
        """Write the joints of a corrected range."""
        joints, fitter, body = self._fitter.joints, self._fitter, self._body.part(rows)
        columns = list(joints.indices(self._joints.names))
        arrays = {name: array[rows] for name, array in self._arrays.items()}  # views: they are written in place
        was_known = np.isfinite(arrays["xyz_m"]).all(-1)
        fit = self._skeleton(body)
        posed_m = []
        for motion in (before, after):
            fit.set_pose(motion.root_m, motion.parent_from_joint[:, : len(SKELETON)])
            posed_m.append(poses.all_posed_m(fit, motion, joints, self._joints))
        # Joints that a low-pass smoothed are not exactly where the skeleton has them.
        xyz_m = np.where(was_known[..., None], arrays["xyz_m"] + (posed_m[1] - posed_m[0]), posed_m[1])
        is_known, source, sigma_m = was_known.copy(), arrays["source"].copy(), None
        is_changed = self._evidence.is_changed[rows]
        if "uncertainty_m" in arrays:
            sigma_m = arrays["uncertainty_m"].copy()
        if fresh is not None:
            refitted = np.zeros_like(was_known)
            refitted[:, columns] = is_changed[:, columns] & (share == 1.0)[:, None]
            fresh_known, fresh_source = (np.zeros_like(source) for _ in range(2))
            fresh_known[:, columns] = np.isfinite(fresh.track.xyz_m).all(-1)
            fresh_source[:, columns] = fresh.track.source
            is_known = np.where(refitted, fresh_known > 0, is_known)
            source = np.where(refitted, fresh_source, source)
            if sigma_m is not None and fresh.uncertainty_m is not None:
                of_fresh, free_m, fresh_m = share[:, None], sigma_m[:, columns], fresh.uncertainty_m
                variance_m2 = (1.0 - of_fresh) * free_m**2 + of_fresh * fresh_m**2
                kept_m = np.where(of_fresh == 1.0, fresh_m, free_m)
                sigma_m[:, columns] = np.where(np.isfinite(variance_m2), np.sqrt(variance_m2), kept_m)
        for name, by_m in moved_m.items():
            column = joints.index(name)
            is_moved = (np.nan_to_num(by_m) != 0.0).any(-1)
            is_known[:, column] |= is_moved
            source[is_moved, column] = Source.PREDICTED
            if sigma_m is not None:
                at = [row - rows.start for row in self._keys[name] if here.start <= row - rows.start < here.stop]
                usual_m = usual_step_m(self._joints, fitter.timebase)[self._joints.index(name)]
                of_key_m = keying.key_uncertainty_m(at, float(usual_m), sigma_m[:, column], by_m)
                sigma_m[:, column] = np.where(is_moved, of_key_m, sigma_m[:, column])
        is_unseen = is_changed & (self._evidence.located.source[rows] == Source.ABSENT)
        source[is_unseen & (source == Source.MEASURED)] = Source.PREDICTED
        source = np.where(is_known, np.where(source == Source.ABSENT, Source.PREDICTED, source), Source.ABSENT)
        xyz_m = np.where(is_known[..., None], xyz_m, np.nan)
        seen = self._evidence.seen.part(rows)
        marks_m = xyz_m
        if fitter.config.smoothing == "fit":
            marks_m = marks_from_centers(xyz_m, poses.body_of(after), slice(None), joints, fitter.offsets)
        error_px, score, views = reproject(fitter.cameras, marks_m, seen.points_px, seen.score)
        new = {"xyz_m": xyz_m, "source": source, "error_px": error_px, "score": score, "views": views}
        for name in ("score", "views"):
            new[name] = np.where(is_changed, getattr(self._evidence.located, name)[rows], arrays[name])
        if sigma_m is not None:
            new["uncertainty_m"] = np.where(is_known, sigma_m, np.nan)
        for name, array in arrays.items():
            array[here] = new[name][here]


@dataclass(frozen=True, slots=True, eq=False)
class _Fresh:
    """Fit of a range of frames to corrected observations."""

    track: Track3D  # Positions at the start of the fit
    motion: SkeletonMotion  # With hands if the person has them
    points: FootPoints
    uncertainty_m: Float[np.ndarray, "frames joints"] | None


def _distance(is_touched: Bool[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
    """Number of frames to the nearest one that is touched; infinite without any."""
    if not is_touched.any():
        return np.full(len(is_touched), np.inf)
    return np.asarray(distance_transform_edt(~is_touched))


def _rising(share: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
    """Smooth step from 0 to 1."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
