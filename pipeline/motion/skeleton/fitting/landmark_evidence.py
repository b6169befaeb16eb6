"""Evidence of where a person's landmarks are, for the fit of the skeleton."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.motion.skeleton.fitting.positions import SCALES_M
from pipeline.motion.skeleton.fitting.rays import Rays


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkEvidence:
    """Rays, if available, and target positions of landmarks with a weight (1 / variance) along each axis."""

    rays: Rays | None
    landmark: Int[np.ndarray, " landmarks"]
    strength: Float[np.ndarray, "frames landmarks 3"]
    place_m: Float[np.ndarray, "frames landmarks 3"]

    def normal_equations(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> tuple[Float[np.ndarray, "frames landmarks 3 3"], Float[np.ndarray, "frames landmarks 3"]]:
        """Normal equations of the landmarks at positions (metres): matrices, and right sides."""
        curvature = self.strength[..., None] * np.eye(3)
        pull = self.strength * (self.place_m - landmark_m)
        if self.rays is not None:
            for number, joint in enumerate(self.landmark.tolist()):
                xyz_m = landmark_m[:, number]
                normal, right = self.rays.normal_equations(joint, xyz_m, SCALES_M[-1])
                curvature[:, number] += normal
                pull[:, number] += right - np.einsum("fab,fb->fa", normal, xyz_m)
        return curvature, pull

    def precision(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> Float[np.ndarray, "frames landmarks 3 3"]:
        """Inverse covariances of the landmarks at positions (metres)."""
        precision = self.strength[..., None] * np.eye(3)
        if self.rays is not None:
            for number, joint in enumerate(self.landmark.tolist()):
                precision[:, number] += self.rays.precision(joint, landmark_m[:, number], SCALES_M[-1])
        return np.asarray(precision)

    def disagreement(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> Float[np.ndarray, "frames landmarks"]:
        """Share of the views of each landmark that its position (metres) does not explain; 0 without views."""
        share = np.zeros(landmark_m.shape[:2])
        if self.rays is not None:
            for number, joint in enumerate(self.landmark.tolist()):
                share[:, number] = self.rays.disagreement(joint, landmark_m[:, number], SCALES_M[-1])
        return share
