import numpy as np

from pipeline.motion.skeleton.gaps import filled_linearly, filled_relative_to

NAN = np.full(3, np.nan)


def test_linear_inside_and_held_at_the_ends() -> None:
    points = np.array([NAN, [0.0, 1.0, 2.0], NAN, NAN, [3.0, 1.0, -1.0], NAN])
    expected = [[0, 1, 2], [0, 1, 2], [1, 1, 1], [2, 1, 0], [3, 1, -1], [3, 1, -1]]
    np.testing.assert_allclose(filled_linearly(points, np.zeros(3)), expected)


def test_default_where_nothing_is_known() -> None:
    np.testing.assert_allclose(filled_linearly(np.array([NAN, NAN]), np.array([1.0, 2.0, 3.0])), [[1, 2, 3]] * 2)


def test_a_carried_point_keeps_its_offset() -> None:
    reference = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 7.0, 0.0]])
    points = np.array([[0.0, 0.0, 1.0], NAN, [0.0, 7.0, 2.0]])
    np.testing.assert_allclose(
        filled_relative_to(points, reference, np.zeros(3)), np.array([[0, 0, 1], [5, 0, 1.5], [0, 7, 2]])
    )
    np.testing.assert_allclose(filled_relative_to(np.array([NAN] * 3), reference, np.ones(3)), reference + 1)
