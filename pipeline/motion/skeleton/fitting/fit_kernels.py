"""Compiled forward kinematics of a window of frames, its Jacobian, and the normal equations of the fit.

``articulation.Articulation`` documents the tables. ``local`` are rotations from a joint to its parent, ``world`` from a
joint to the world. The first ``NUM_ROOT`` degrees of freedom are the position of the root.
"""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel

_NUM_ROOT = 3
# Squared angle below which sine and cosine of a rotation are replaced by their first terms.
_TINY_RAD2 = 1e-12
# Distance below which both ends of a limb are at the same position.
_SAME_M = 1e-3


@kernel
@no_type_check
def pose(root_m, local, parent, offset_m, landmark_joint, landmark_offset_m, world, joint_m, landmark_m):
    """Compute poses of joints and positions of landmarks; ``world``, ``joint_m``, ``landmark_m`` are outputs."""
    for frame in range(len(root_m)):
        for joint in range(len(parent)):
            above = parent[joint]
            for row in range(3):
                if above < 0:
                    joint_m[frame, joint, row] = root_m[frame, row]
                    for column in range(3):
                        world[frame, joint, row, column] = local[frame, joint, row, column]
                    continue
                place_m = joint_m[frame, above, row]
                for k in range(3):
                    place_m += world[frame, above, row, k] * offset_m[joint, k]
                joint_m[frame, joint, row] = place_m
                for column in range(3):
                    total = 0.0
                    for k in range(3):
                        total += world[frame, above, row, k] * local[frame, joint, k, column]
                    world[frame, joint, row, column] = total
        for landmark in range(len(landmark_joint)):
            joint = landmark_joint[landmark]
            for row in range(3):
                place_m = joint_m[frame, joint, row]
                for k in range(3):
                    place_m += world[frame, joint, row, k] * landmark_offset_m[landmark, k]
                landmark_m[frame, landmark, row] = place_m


@kernel
@no_type_check
def differentiate(world, joint_m, landmark_m, freedom_joint, freedom_axis, moved_by, num_moved_by, jacobian):
    """Compute the derivatives of landmarks by the degrees of freedom that move them; ``jacobian`` is the output.

    The derivative by a rotation of a joint is the cross product of the axis and the vector from joint to landmark.
    """
    for frame in range(len(world)):
        for landmark in range(len(num_moved_by)):
            for k in range(num_moved_by[landmark]):
                freedom = moved_by[landmark, k]
                row = jacobian[frame, landmark, k]
                row[0] = row[1] = row[2] = 0.0
                if freedom < _NUM_ROOT:
                    row[freedom] = 1.0
                    continue
                for which in range(2):
                    joint = freedom_joint[freedom, which]
                    if joint < 0:
                        continue
                    turn, axis = world[frame, joint], freedom_axis[freedom]
                    x = turn[0, 0] * axis[0] + turn[0, 1] * axis[1] + turn[0, 2] * axis[2]
                    y = turn[1, 0] * axis[0] + turn[1, 1] * axis[1] + turn[1, 2] * axis[2]
                    z = turn[2, 0] * axis[0] + turn[2, 1] * axis[1] + turn[2, 2] * axis[2]
                    u = landmark_m[frame, landmark, 0] - joint_m[frame, joint, 0]
                    v = landmark_m[frame, landmark, 1] - joint_m[frame, joint, 1]
                    w = landmark_m[frame, landmark, 2] - joint_m[frame, joint, 2]
                    row[0] += y * w - z * v
                    row[1] += z * u - x * w
                    row[2] += x * v - y * u


@kernel
@no_type_check
def assemble(jacobian, moved_by, num_moved_by, curvature, pull, tie, second_m, lower, right):
    """Add the terms of landmarks to the normal equations; ``lower`` and ``right`` are outputs.

    ``lower[i, k]`` is the element k rows below the diagonal of column i. The degrees of freedom of a frame are
    consecutive. ``curvature`` and ``pull`` are the second and the negative first derivative of a landmark's own energy;
    ``tie`` is the weight of its second difference ``second_m`` over three frames.
    """
    num_frames, num_freedoms = len(jacobian), len(right) // len(jacobian)
    for frame in range(num_frames):
        first = frame * num_freedoms
        for landmark in range(len(num_moved_by)):
            begun = tie[frame, landmark] if frame < num_frames - 2 else 0.0
            middle = tie[frame - 1, landmark] if 0 < frame < num_frames - 1 else 0.0
            ended = tie[frame - 2, landmark] if frame > 1 else 0.0
            own, following, second = begun + 4 * middle + ended, -2 * (begun + middle), begun
            here = curvature[frame, landmark]
            x, y, z = pull[frame, landmark, 0], pull[frame, landmark, 1], pull[frame, landmark, 2]
            if begun > 0:
                x -= begun * second_m[frame, landmark, 0]
                y -= begun * second_m[frame, landmark, 1]
                z -= begun * second_m[frame, landmark, 2]
            if middle > 0:
                x += 2 * middle * second_m[frame - 1, landmark, 0]
                y += 2 * middle * second_m[frame - 1, landmark, 1]
                z += 2 * middle * second_m[frame - 1, landmark, 2]
            if ended > 0:
                x -= ended * second_m[frame - 2, landmark, 0]
                y -= ended * second_m[frame - 2, landmark, 1]
                z -= ended * second_m[frame - 2, landmark, 2]
            count = num_moved_by[landmark]
            for k in range(count):
                column = first + moved_by[landmark, k]
                a, b, c = (
                    jacobian[frame, landmark, k, 0],
                    jacobian[frame, landmark, k, 1],
                    jacobian[frame, landmark, k, 2],
                )
                right[column] += a * x + b * y + c * z
                u = (here[0, 0] + own) * a + here[0, 1] * b + here[0, 2] * c
                v = here[1, 0] * a + (here[1, 1] + own) * b + here[1, 2] * c
                w = here[2, 0] * a + here[2, 1] * b + (here[2, 2] + own) * c
                for m in range(k, count):
                    other = jacobian[frame, landmark, m]
                    below = moved_by[landmark, m] - moved_by[landmark, k]
                    lower[column, below] += u * other[0] + v * other[1] + w * other[2]
                for ahead in range(1, 3):
                    weight = following if ahead == 1 else second
                    if weight == 0.0 or frame + ahead >= num_frames:
                        continue
                    for m in range(count):
                        other = jacobian[frame + ahead, landmark, m]
                        below = ahead * num_freedoms + moved_by[landmark, m] - moved_by[landmark, k]
                        lower[column, below] += weight * (a * other[0] + b * other[1] + c * other[2])


@kernel
@no_type_check
def factorise(jacobian, moved_by, num_moved_by, precision, priors, factor):
    """Compute Cholesky's factor of the curvature of each frame by itself; ``factor`` is the output.

    The curvature of a frame's degrees of freedom is the sum of J' P J over the landmarks, with their derivatives J and
    precisions P, plus ``priors`` on the diagonal. The factor is the lower triangle; the rest of the output is 0.
    """
    num_freedoms = len(priors)
    for frame in range(len(jacobian)):
        lower = factor[frame]
        lower[:, :] = 0.0
        for freedom in range(num_freedoms):
            lower[freedom, freedom] = priors[freedom]
        for landmark in range(len(num_moved_by)):
            here = precision[frame, landmark]
            for k in range(num_moved_by[landmark]):
                one = jacobian[frame, landmark, k]
                u = here[0, 0] * one[0] + here[0, 1] * one[1] + here[0, 2] * one[2]
                v = here[1, 0] * one[0] + here[1, 1] * one[1] + here[1, 2] * one[2]
                w = here[2, 0] * one[0] + here[2, 1] * one[1] + here[2, 2] * one[2]
                for m in range(k + 1):
                    other = jacobian[frame, landmark, m]
                    lower[moved_by[landmark, k], moved_by[landmark, m]] += u * other[0] + v * other[1] + w * other[2]
        for row in range(num_freedoms):
            for column in range(row + 1):
                total = lower[row, column]
                for k in range(column):
                    total -= lower[row, k] * lower[column, k]
                lower[row, column] = np.sqrt(total) if row == column else total / lower[column, column]


@kernel
@no_type_check
def spread(jacobian, moved_by, num_moved_by, factor, solved, variance):
    """Compute the mean variance of landmarks over the axes in each frame; ``variance`` is the output.

    With Cholesky's factor L of ``factorise``, the covariance of a landmark with the derivatives J is Y' Y, where
    L Y = J'. ``solved`` is memory for Y.
    """
    for frame in range(len(jacobian)):
        lower = factor[frame]
        for landmark in range(len(num_moved_by)):
            solved[:, :] = 0.0
            for k in range(num_moved_by[landmark]):
                for axis in range(3):
                    solved[moved_by[landmark, k], axis] = jacobian[frame, landmark, k, axis]
            square = 0.0
            for row in range(len(solved)):
                x, y, z = solved[row, 0], solved[row, 1], solved[row, 2]
                for k in range(row):
                    x -= lower[row, k] * solved[k, 0]
                    y -= lower[row, k] * solved[k, 1]
                    z -= lower[row, k] * solved[k, 2]
                x, y, z = x / lower[row, row], y / lower[row, row], z / lower[row, row]
                solved[row, 0], solved[row, 1], solved[row, 2] = x, y, z
                square += x * x + y * y + z * z
            variance[frame, landmark] = square / 3.0


@kernel
@no_type_check
def turn(step, freedom_joint, freedom_axis, lowest_rad, highest_rad, longest_rad, root_m, angle_rad, local):
    """Apply a step to all degrees of freedom in place.

    Rotations are limited to ``longest_rad``, and hinges to their range. ``angle_rad`` are the angles of hinges; entries
    of other rotations are unused.
    """
    num_joints = local.shape[1]
    num_freedoms = step.shape[1]
    for frame in range(len(step)):
        for axis in range(3):
            root_m[frame, axis] += step[frame, axis]
        for joint in range(num_joints):
            x, y, z = 0.0, 0.0, 0.0
            for freedom in range(_NUM_ROOT, num_freedoms):
                if freedom_joint[freedom, 0] != joint and freedom_joint[freedom, 1] != joint:
                    continue
                by = min(max(step[frame, freedom], -longest_rad), longest_rad)
                if freedom_joint[freedom, 0] == joint and lowest_rad[freedom] > -np.inf:
                    reached = min(max(angle_rad[frame, freedom] + by, lowest_rad[freedom]), highest_rad[freedom])
                    by = reached - angle_rad[frame, freedom]
                    angle_rad[frame, freedom] = reached
                x += by * freedom_axis[freedom, 0]
                y += by * freedom_axis[freedom, 1]
                z += by * freedom_axis[freedom, 2]
            square = x * x + y * y + z * z
            if square == 0.0:
                continue
            # Rodrigues' formula.
            angle = np.sqrt(square)
            sine = np.sin(angle) / angle if square > _TINY_RAD2 else 1.0
            cosine = (1.0 - np.cos(angle)) / square if square > _TINY_RAD2 else 0.5
            r00, r11, r22 = 1 - cosine * (y * y + z * z), 1 - cosine * (x * x + z * z), 1 - cosine * (x * x + y * y)
            r01, r10 = cosine * x * y - sine * z, cosine * x * y + sine * z
            r02, r20 = cosine * x * z + sine * y, cosine * x * z - sine * y
            r12, r21 = cosine * y * z - sine * x, cosine * y * z + sine * x
            for row in range(3):
                a, b, c = local[frame, joint, row, 0], local[frame, joint, row, 1], local[frame, joint, row, 2]
                local[frame, joint, row, 0] = a * r00 + b * r10 + c * r20
                local[frame, joint, row, 1] = a * r01 + b * r11 + c * r21
                local[frame, joint, row, 2] = a * r02 + b * r12 + c * r22


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
def sum_normal_equations(rays, center_m, weights, xyz_m, scale_m, normal, right):
    """Add up the normal equations of a joint over its rays; ``normal`` and ``right`` are outputs.

    A ray with unit vector r from c contributes its weight times ``I - r r^T`` and ``(I - r r^T) c``. ``weights`` are
    multiplied with the weights of the function of Geman and McClure with the scale ``scale_m`` at the position.
    """
    normal[:] = 0.0
    right[:] = 0.0
    for frame in range(len(rays)):
        for camera in range(len(center_m)):
            if weights[frame, camera] == 0.0:
                continue
            ray, center = rays[frame, camera], center_m[camera]
            x, y, z = xyz_m[frame, 0] - center[0], xyz_m[frame, 1] - center[1], xyz_m[frame, 2] - center[2]
            ahead_m = ray[0] * x + ray[1] * y + ray[2] * z
            off_m2 = (x - ahead_m * ray[0]) ** 2 + (y - ahead_m * ray[1]) ** 2 + (z - ahead_m * ray[2]) ** 2
            share = scale_m * scale_m / (off_m2 + scale_m * scale_m)
            weight = weights[frame, camera] * share * share
            along = ray[0] * center[0] + ray[1] * center[1] + ray[2] * center[2]
            for row in range(3):
                turned = weight * ray[row]
                right[frame, row] += weight * center[row] - turned * along
                normal[frame, row, row] += weight
                for column in range(3):
                    normal[frame, row, column] -= turned * ray[column]


@kernel
@no_type_check
def add_bone(here_m, other_m, length_m, weight, pulls, normal, right):
    """Add the Newton terms of a limb's length in the frames in which it pulls; ``normal`` and ``right`` are outputs.

    Of the matrices the upper triangles are added. There are no terms where the other end is unknown or at the same
    position. Positive curvature across the limb is kept. Without it, a joint with few other constraints would diverge.
    """
    for frame in range(len(here_m)):
        x, y, z = here_m[frame, 0], here_m[frame, 1], here_m[frame, 2]
        u, v, w = x - other_m[frame, 0], y - other_m[frame, 1], z - other_m[frame, 2]
        distance_m = np.sqrt(u * u + v * v + w * w)
        if not (pulls[frame] and distance_m > _SAME_M):
            continue
        u, v, w = u / distance_m, v / distance_m, w / distance_m
        across = max(1.0 - length_m / distance_m, 0.0) * weight
        along = weight - across
        pull = weight * (distance_m - length_m)
        # Product of the curvature with the position, less the pull.
        here = along * (u * x + v * y + w * z) - pull
        right[frame, 0] += across * x + here * u
        right[frame, 1] += across * y + here * v
        right[frame, 2] += across * z + here * w
        matrix = normal[frame]
        matrix[0, 0] += across + along * u * u
        matrix[1, 1] += across + along * v * v
        matrix[2, 2] += across + along * w * w
        matrix[0, 1] += along * u * v
        matrix[0, 2] += along * u * w
        matrix[1, 2] += along * v * w


@kernel
@no_type_check
def _solve_banded(lower, solved, count):
    """Solve a positive definite system of ``count`` unknowns in place; ``lower`` becomes Cholesky's factor."""
    for i in range(count):
        over = 1.0 / np.sqrt(lower[i, 0])
        for k in range(lower.shape[1]):
            lower[i, k] *= over
        solved[i] *= over
        for k in range(1, lower.shape[1]):
            solved[i + k] -= lower[i, k] * solved[i]
            for m in range(k, lower.shape[1]):
                lower[i + k, m - k] -= lower[i, k] * lower[i, m]
    for i in range(count - 1, -1, -1):
        for k in range(1, lower.shape[1]):
            solved[i] -= lower[i, k] * solved[i + k]
        solved[i] /= lower[i, 0]


@kernel
@no_type_check
def solve_over_time(normal, right, usual_m, heavy_tail, inertia, longest_m, lower, solved, xyz_m):
    """Move a joint by a step of Newton's method: normal equations of all frames, coupled by the acceleration.

    - ``normal``, ``right``: normal equations of the frames' evidence; of the matrices the upper triangles are read.
    - ``usual_m``, ``heavy_tail``: usual second difference, and the factor at which Cauchy's function becomes
      heavy-tailed.
    - ``inertia``: weight that keeps the joint in place.
    - ``longest_m``: longest step.
    - ``lower``, ``solved``: workspace of zeros, (3 * frames + 8, 9) and (3 * frames + 8,).
    - ``xyz_m``: positions, (frames, 3), changed in place.
    """
    num_frames = len(xyz_m)
    # ``lower[i, k]`` is the element k rows below the diagonal of column i.
    for frame in range(num_frames):
        for row in range(3):
            solved[3 * frame + row] = right[frame, row] + inertia * xyz_m[frame, row]
            for column in range(row, 3):
                lower[3 * frame + row, column - row] = normal[frame, row, column]
            lower[3 * frame + row, 0] += inertia
    for frame in range(num_frames - 2):
        square_m2 = 0.0
        for axis in range(3):
            square_m2 += (xyz_m[frame, axis] - 2 * xyz_m[frame + 1, axis] + xyz_m[frame + 2, axis]) ** 2
        usual_m2 = usual_m[frame + 1] ** 2
        tie = 1.0 / (usual_m2 + square_m2 / heavy_tail**2)
        for axis in range(3 * frame, 3 * frame + 3):
            lower[axis, 0] += tie
            lower[axis, 3] -= 2 * tie
            lower[axis, 6] += tie
            lower[axis + 3, 0] += 4 * tie
            lower[axis + 3, 3] -= 2 * tie
            lower[axis + 6, 0] += tie
    _solve_banded(lower, solved, 3 * num_frames)
    for frame in range(num_frames):
        x, y, z = (
            solved[3 * frame] - xyz_m[frame, 0],
            solved[3 * frame + 1] - xyz_m[frame, 1],
            solved[3 * frame + 2] - xyz_m[frame, 2],
        )
        share = min(1.0, longest_m / max(np.sqrt(x * x + y * y + z * z), 1e-9))
        xyz_m[frame, 0] += share * x
        xyz_m[frame, 1] += share * y
        xyz_m[frame, 2] += share * z
