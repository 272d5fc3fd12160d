"""Vectors of arrays multiply as NumPy's do."""

import numpy as np

from dynident.models.inertia import cross, diagonal, dot, matmul, matvec, outer, transposed_matvec

A, B = np.random.default_rng(0).normal(size=(2, 3, 3, 4, 5))
a, b = np.random.default_rng(1).normal(size=(2, 3, 4, 5))
LAST = (2, 3, 0, 1)  # samples first, as NumPy has matrices


def same(found, expected):
    np.testing.assert_allclose(found, np.moveaxis(expected, (0, 1), (-2, -1)), rtol=1e-14, atol=1e-15)


def test_products():
    first, second, x, y = A.transpose(LAST), B.transpose(LAST), np.moveaxis(a, 0, -1), np.moveaxis(b, 0, -1)
    same(dot(a, b), (x * y).sum(axis=-1))
    same(cross(a, b), np.cross(x, y))
    same(matvec(A, b), (first @ y[..., None])[..., 0])
    same(transposed_matvec(A, b), (first.swapaxes(2, 3) @ y[..., None])[..., 0])
    same(matmul(A, B), first @ second)
    same(outer(a, b), x[..., :, None] * y[..., None, :])
    same(diagonal(a[0]), a[0][..., None, None] * np.eye(3))


def test_constants_meet_arrays():
    np.testing.assert_allclose(cross(a, b[:, :, :1]), cross(a, np.broadcast_to(b[:, :, :1], a.shape)))
