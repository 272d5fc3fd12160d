"""What a fit knows of its base parameters together."""

import numpy as np

from tests.apps.payload.arms import result


def test_friction_that_grows_with_the_load_moves_them_by_its_part() -> None:
    actual, share = result(), 1e-3
    (log,) = actual.validations
    motion, basis, weights = log.motion, actual.base.on_data, actual.estimate.residual.weights
    bodies = actual.model.bodies
    load = bodies.torque(motion.q, motion.dq, motion.ddq, actual.estimate.value[: len(bodies.parameters)])
    more = share * np.abs(load) * np.sign(motion.dq) * np.eye(6)[4]
    Y, rows = actual.model.regressor(motion.q, motion.dq, motion.ddq), motion.mask
    columns = (weights[:, None] * Y[rows][:, :, list(basis.independent)]).reshape(-1, basis.rank)
    moved = np.linalg.lstsq(columns, (weights * more[rows]).ravel(), rcond=None)[0]
    np.testing.assert_allclose(share * actual.errors.base_by_load[:, 4], moved, rtol=1e-5, atol=1e-9)


def test_the_covariance_is_that_of_the_standard_errors() -> None:
    errors = result().errors
    ratio = np.sqrt(np.diag(errors.base_covariance)) / errors.base_std
    assert 0.8 < np.median(ratio) < 1.4
    assert (ratio > 0.5).all()
    scale = np.sqrt(np.diag(errors.base_covariance))
    assert np.linalg.eigvalsh(errors.base_covariance / np.outer(scale, scale))[0] > 0
