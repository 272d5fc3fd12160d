"""Requests that contradict themselves, the model or the limits are refused, with what to change."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import Criterion, LeftOut, Program
from dynident.apps.excitation.motion import check_request, criterion_rows, without_memory
from dynident.models.friction import Dahl
from dynident.runtime import ConfigError, InputError
from tests.apps.excitation.arms import LIMITS, MODEL, THETA
from tests.apps.excitation.requests import BASIS, REQUEST, SPACE

SCALE = np.ones(BASIS.rank)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sigma": np.ones(3)}, "noise of the torque .* each of 2 joints"),
        ({"sigma": np.array([1.0, 0.0])}, "positive number"),
        ({"sigma": np.array([1.0, np.nan])}, "positive number"),
        ({"duration": 0.0}, "duration is 0.0; give a positive number"),
        ({"duration": np.inf}, "duration is inf"),
        ({"rate": -1.0}, "rate is -1.0"),
        ({"period": np.nan}, "period is nan"),
        ({"harmonics": 0}, "harmonics is 0; give 1 or more"),
        ({"starts": 0}, "starts is 0"),
        ({"family": "spline"}, "family is 'spline'.*bspline"),
        ({"period": 10.0}, "period of 10 s is longer than the duration of 9 s"),
        ({"prior": np.eye(3)}, r"prior information has shape \(3, 3\), expected \(26, 26\)"),
        ({"start": np.zeros(3)}, r"start has shape \(3,\)"),
        ({"start": np.array([0.0, 2.7])}, "start: joint 'bend' is at 2.7, outside of -2.52 to 2.52"),
        ({"start": np.array([np.nan, 0.0])}, "start: joint 'lift' is at nan"),
    ],
)
def test_what_cannot_be_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        check_request(MODEL, THETA, LIMITS, SPACE, replace(REQUEST, **changes))


def test_a_start_in_collision_names_the_pair():
    with pytest.raises(InputError, match="the start: 'lower' and 'post' overlap"):
        check_request(MODEL, THETA, LIMITS, SPACE, replace(REQUEST, start=np.zeros(2)))


def test_what_does_not_fit_the_model_is_refused():
    with pytest.raises(ConfigError, match=r"theta has shape \(3,\), expected 26"):
        check_request(MODEL, np.zeros(3), LIMITS, SPACE, REQUEST)
    with pytest.raises(ConfigError, match="theta"):
        check_request(MODEL, np.full(26, np.nan), LIMITS, SPACE, REQUEST)
    with pytest.raises(ConfigError, match="limits are of the joints"):
        check_request(MODEL, THETA, replace(LIMITS, joints=("a", "b")), SPACE, REQUEST)


def test_a_period_matters_to_motions_that_have_one():
    for changes in ({"family": "bspline"}, {"program": Program.FRICTION}):
        check_request(MODEL, THETA, LIMITS, SPACE, replace(REQUEST, period=10.0, **changes))


def test_names_give_the_rows_of_their_base_parameters():
    request = replace(REQUEST, criterion=Criterion.A_OPTIMAL, named=("Fv_lift", "offset_bend"))
    rows = criterion_rows(BASIS, THETA, request, SCALE)
    values = BASIS.to_base(THETA)
    which = [BASIS.leading.index(name) for name in request.named]
    np.testing.assert_allclose(rows @ np.eye(BASIS.rank)[:, which], np.diag(1 / np.abs(values[which])))
    assert (rows != 0).sum() == 2
    assert criterion_rows(BASIS, THETA, replace(request, criterion=Criterion.D_OPTIMAL), SCALE) is None
    assert criterion_rows(BASIS, THETA, replace(request, named=()), SCALE) is None


def test_a_value_of_zero_counts_as_what_is_usual():
    names, scale = ("Fv_lift", "Fv_bend"), np.arange(1.0, BASIS.rank + 1)
    request = replace(REQUEST, criterion=Criterion.A_OPTIMAL, named=names)
    k, j = (BASIS.leading.index(name) for name in names)
    theta = THETA.copy()
    theta[BASIS.names.index("Fv_bend")] = 0.0
    rows = criterion_rows(BASIS, theta, request, scale)
    assert 1 / rows[1, j] == pytest.approx(theta[BASIS.names.index("Fv_lift")] * scale[k] / scale[j])
    assert np.isfinite(criterion_rows(BASIS, 0 * theta, request, scale)).all()


def test_names_that_are_not_there_or_never_alone_are_refused():
    request = replace(REQUEST, criterion=Criterion.A_OPTIMAL)
    with pytest.raises(ConfigError, match="there is no parameter 'Fv_lit'; did you mean 'Fv_lift'"):
        criterion_rows(BASIS, THETA, replace(request, named=("Fv_lit",)), SCALE)
    never = next(name for name in BASIS.names if name not in BASIS.leading)
    with pytest.raises(ConfigError, match=f"no motion shows '{never}' by itself"):
        criterion_rows(BASIS, THETA, replace(request, named=(never,)), SCALE)


def test_terms_that_remember_are_left_out_with_what_belongs_to_them():
    model = MODEL.with_terms(Dahl(MODEL.joints))
    p, own = len(model.parameters), len(THETA)
    prior = np.diag(np.arange(1.0, p + 1))
    theta = np.concatenate([THETA, np.ones(p - own)])
    bare, rest, request, notes = without_memory(model, theta, replace(REQUEST, prior=prior))
    assert bare.names == MODEL.names
    np.testing.assert_array_equal(rest, THETA)
    np.testing.assert_array_equal(np.diag(request.prior), np.arange(1.0, own + 1))
    assert notes == (LeftOut(("Dahl",)),)
    assert without_memory(MODEL, THETA, REQUEST) == (MODEL, THETA, REQUEST, ())
