import jax.numpy as jnp
import numpy as np
import pytest

from jaxlocomanip.locomotion.algebra import inverse, inverse3, skew, yaw_matrix, yaw_of

RNG = np.random.default_rng(0)


def test_skew_is_the_cross_product():
    a, b = RNG.normal(size=(2, 5, 3)).astype(np.float32)
    assert jnp.einsum("nij,nj->ni", skew(a), b) == pytest.approx(np.cross(a, b), abs=1e-6)


def test_inverse3_and_its_bound():
    matrix = RNG.normal(size=(20, 3, 3)).astype(np.float32)
    product = np.asarray(inverse3(matrix)) @ matrix
    assert product == pytest.approx(np.broadcast_to(np.eye(3), (20, 3, 3)), abs=2e-4)
    flat = jnp.ones((3, 3)) - 1e-8 * jnp.eye(3)
    assert np.isfinite(inverse3(flat, 1e-3)).all()


@pytest.mark.parametrize("size", [1, 6, 10, 60])
def test_inverse_of_badly_scaled_matrices(size):
    basis, _ = np.linalg.qr(RNG.normal(size=(size, size)))
    matrix = ((basis * np.geomspace(1.0, 1e4, size)) @ basis.T).astype(np.float32)
    batch = np.stack([matrix, 1e-6 * matrix])
    found = np.asarray(inverse(batch)).astype(float)
    exact = np.linalg.inv(batch.astype(float))
    error = np.linalg.norm(found - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert error.max() < 5e-3  # condition 1e4 times the resolution of single precision, with room


def test_yaw():
    angle = jnp.float32(0.7)
    assert yaw_of(yaw_matrix(angle)) == pytest.approx(0.7, abs=1e-6)
    assert yaw_matrix(angle) @ jnp.array([1.0, 0.0, 2.0]) == pytest.approx([np.cos(0.7), np.sin(0.7), 2.0], abs=1e-6)
