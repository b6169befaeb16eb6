import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pipeline.core.data.rigid import Rigid3

vectors = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
transforms = st.builds(lambda turn, shift: Rigid3(Rotation.from_rotvec(turn).as_matrix(), shift), vectors, vectors)


@given(a=transforms, b=transforms, c=transforms, point=vectors)
def test_group_laws(a: Rigid3, b: Rigid3, c: Rigid3, point: np.ndarray) -> None:
    np.testing.assert_allclose(((a @ b) @ c).apply(point), (a @ (b @ c)).apply(point), atol=1e-12)
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-12)
    np.testing.assert_allclose((a @ a.inverse()).apply(point), point, atol=1e-12)
    np.testing.assert_allclose(a.inverse().apply(a.apply(point)), point, atol=1e-12)


def test_quarter_turn_and_step() -> None:
    b_from_a = Rigid3(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, 0.0, 5.0]))
    np.testing.assert_allclose(b_from_a.apply(np.array([1.0, 0.0, 0.0])), [0.0, 1.0, 5.0])
