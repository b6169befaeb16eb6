"""Compiled sums over the rays of a joint; ``rays.Rays`` documents the energy.

``ray`` are unit vectors (frames, cameras, 3), 0 with weight 0 where nothing is seen, ``center_m`` the cameras' centres.
"""

from typing import no_type_check

from pipeline.core.runtime.jit import kernel


@kernel
@no_type_check
def squared_distances(ray, center_m, xyz_m, off_m2):
    """Compute the squared distance of a joint's position to each ray; ``off_m2`` is the output."""
    for frame in range(len(ray)):
        for camera in range(len(center_m)):
            x = xyz_m[frame, 0] - center_m[camera, 0]
            y = xyz_m[frame, 1] - center_m[camera, 1]
            z = xyz_m[frame, 2] - center_m[camera, 2]
            u, v, w = ray[frame, camera, 0], ray[frame, camera, 1], ray[frame, camera, 2]
            along = u * x + v * y + w * z
            off_m2[frame, camera] = (x - along * u) ** 2 + (y - along * v) ** 2 + (z - along * w) ** 2


@kernel
@no_type_check
def sum_normal_equations(ray, center_m, weight, normal, right):
    """Add up the normal equations of a joint over its rays; ``normal`` and ``right`` are outputs.

    A ray with unit vector r from c contributes its weight times ``I - r r^T`` and ``(I - r r^T) c``.
    """
    normal[:] = 0.0
    right[:] = 0.0
    for frame in range(len(ray)):
        for camera in range(len(center_m)):
            along = 0.0
            for row in range(3):
                along += ray[frame, camera, row] * center_m[camera, row]
            for row in range(3):
                turned = weight[frame, camera] * ray[frame, camera, row]
                right[frame, row] += weight[frame, camera] * center_m[camera, row] - turned * along
                normal[frame, row, row] += weight[frame, camera]
                for column in range(3):
                    normal[frame, row, column] -= turned * ray[frame, camera, column]
