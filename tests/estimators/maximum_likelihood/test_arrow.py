"""A matrix with a band and a border: solved, inverted, gathered."""

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood.trajectory import Arrow, add_ahead, add_rows, band_of, places
from dynident.runtime import ModelError


class TestArrow:
    def matrix(self, rng: np.random.Generator, size: int = 14, w: int = 4) -> tuple[np.ndarray, np.ndarray]:
        L = np.tril(rng.standard_normal((size, size))) * (np.abs(np.subtract.outer(range(size), range(size))) < w)
        A = (L + 3 * np.eye(size)) @ (L + 3 * np.eye(size)).T
        band = np.zeros((w, size))
        for d in range(w):
            band[d, : size - d] = np.diag(A, -d)
        return A, band

    def test_solves_and_inverts(self, rng: np.random.Generator) -> None:
        A, band = self.matrix(rng)
        B = rng.standard_normal((14, 3))
        arrow, inverse = Arrow(band, B), np.linalg.inv(A)
        np.testing.assert_allclose(arrow.solve_band(B), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.solve_transposed(arrow.half), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.lost_information, B.T @ inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.log_det, np.linalg.slogdet(A)[1], rtol=1e-12)
        for d in range(4):
            np.testing.assert_allclose(arrow.inverse[d, : 14 - d], np.diag(inverse, -d), rtol=1e-9, atol=1e-14)

    @pytest.mark.parametrize("first", [[0, 2, 3], [0, 1, 2]])
    def test_adds_up_overlapping_blocks(self, rng: np.random.Generator, first: list[int]) -> None:
        """Blocks of three unknowns of two joints each, at places that do or do not follow each other."""
        half = rng.standard_normal((3, 6, 6))
        blocks, rows = half @ half.swapaxes(1, 2), rng.standard_normal((3, 6, 4))
        full, side = np.zeros((12, 12)), np.zeros((12, 4))
        for at, block, row in zip(first, blocks, rows, strict=True):
            here = slice(2 * at, 2 * at + 6)
            full[here, here] += block
            side[here] += row
        ahead, border, at = np.zeros((6, 2, 6)), np.zeros((6, 2, 4)), places(np.array(first), 3)
        add_ahead(ahead, blocks.reshape(3, 3, 2, 6), at)
        add_rows(border, rows.reshape(3, 3, 2, 4), at)
        band = band_of(ahead)
        for d in range(6):
            np.testing.assert_allclose(band[d, : 12 - d], np.diag(full, -d), atol=1e-15)
            assert not band[d, 12 - d :].any()
        np.testing.assert_allclose(border.reshape(12, 4), side)

    def test_refuses_what_is_not_determined(self) -> None:
        with pytest.raises(ModelError, match="not determined"):
            Arrow(np.zeros((2, 5)), np.zeros((5, 1))).solve_band(np.ones((5, 1)))
