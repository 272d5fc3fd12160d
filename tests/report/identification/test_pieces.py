"""A fit in pieces in a report: the residual of each piece over the time."""

import numpy as np

from dynident.estimators import Pieces
from dynident.report.identification.figures import pieces_figure


def pieces(length: float, names: tuple[str, ...] = ("day",) * 4) -> Pieces:
    begins = np.arange(4) * length
    rows = np.array([[100, 100], [100, 0], [100, 100], [100, 300]])
    torque, residual = np.full((4, 2), [10.0, 4.0]), np.array([[1.0, 0.4], [2.0, 0.0], [1.0, 0.4], [1.0, 0.4]])
    return Pieces(names, begins, begins + length, rows, torque * (rows > 0), residual)


def test_residuals_are_relative_to_the_torque_of_all_pieces() -> None:
    figure = pieces_figure(pieces(100.0), ("one", "two"))
    case, two = figure.data
    np.testing.assert_allclose(case["y"], [10, 20, 10, 10])
    np.testing.assert_allclose(two["y"], [10, np.nan, 10, 10])  # nothing was fitted in the second
    np.testing.assert_allclose(case["x"], [50, 150, 250, 350])
    assert figure.layout["xaxis"]["title"] == {"text": "time, s"}
    np.testing.assert_allclose(pieces(100.0).relative_error, [100 * np.sqrt(7 / 400), 10.0])


def test_a_joint_without_torque_has_no_curve() -> None:
    given = pieces(100.0)
    none = Pieces(given.recording, given.begins, given.ends, given.rows, given.torque * [1, 0], given.residual)
    assert len(pieces_figure(none, ("one", "two")).data) == 1
