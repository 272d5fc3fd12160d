"""How an identification shows itself: in a terminal, in a notebook, figure by figure."""

import re
from dataclasses import replace

import numpy as np
import pytest

import dynident as dy
from dynident.models.lagrangian import slider
from dynident.runtime import InputError

T = np.arange(1501) * 0.01
EVIL = "<script>alert('x')</script>"


def swinging(rate: float, name: str) -> dy.Log:
    q = 0.1 * np.sin(rate * T)[:, None]
    noise = 0.02 * np.random.default_rng(0).standard_normal((1501, 1))
    tau = -5.0 * rate**2 * q + 8.0 * 0.1 * rate * np.cos(rate * T)[:, None] + noise
    return dy.Log(T, q, tau, ("slider",), name)


@pytest.fixture(scope="module")
def example() -> dy.Identification:
    method = dy.Recipe(dy.Difference("central"), restart=1.0)
    return dy.identify("gallery:slider", swinging(3, "monday"), swinging(4, "tuesday"), method)


@pytest.fixture(scope="module")
def saved(example: dy.Identification) -> dy.Identification:
    """As a result is loaded: without signals."""
    return replace(example, validations=tuple(replace(validation, signals=None) for validation in example.validations))


def test_a_plot_lists_its_figures(example: dy.Identification) -> None:
    figures = [name for name in dir(example.plot) if not name.startswith("_") and name != "identification"]
    assert sorted(figures) == sorted(re.findall(r"(\w+)\((?!file)", repr(example.plot)))


def test_columns_of_a_check_say_of_what_they_are() -> None:
    html = dy.check("gallery:slider", swinging(3, "monday"), recipe=dy.Recipe(dy.Difference()))._repr_html_()
    for words in ("position<br>from", "speed<br>peak", "acceleration<br>peak", "torque<br>peak"):
        assert words in html


def test_what_forbids_its_use_is_said_first() -> None:
    alone = dy.identify("gallery:slider", swinging(3, "monday"), recipe=dy.Recipe(dy.Difference("central")))
    assert repr(alone).splitlines()[:2] == [
        "<Identification of 'slider': do not use",
        "  no log was held out, so the error on unseen motion is not known",
    ]


def test_a_notebook_shows_tables_and_no_markup_of_names(example: dy.Identification) -> None:
    model = replace(example.model, name=EVIL)
    evil = replace(
        example, model=model, validations=tuple(replace(validation, name=EVIL) for validation in example.validations)
    )
    html = evil._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;" in html
    assert html.count("<table>") == html.count("</table>") == 2
    for words in ("Verdict: ", "Fv", "N s/m", "held out"):
        assert words in html


def test_frames_hold_the_numbers(example: dy.Identification) -> None:
    table = example.frame()
    assert table["parameter"].to_list() == list(slider().names)
    np.testing.assert_array_equal(table["value"], example.estimate.value)
    np.testing.assert_array_equal(table["std"], example.errors.std)
    errors = example.validations[1].frame()
    assert errors["joint"].to_list() == ["slider"]
    assert errors["relative_error"][0] == example.validations[1].errors.per_joint["slider"]
    assert errors["relative_error_filtered"].to_list() == [None]


def test_figures_are_those_of_the_report(example: dy.Identification) -> None:
    predicted = example.plot.torque("tuesday", "slider").data[1]
    assert predicted.name == "predicted"
    assert example.plot.torque().data[1].y[100] == predicted.y[100]  # held out by default
    assert example.plot.torque("monday").data[1].y[100] != predicted.y[100]
    assert [trace.name for trace in example.plot.smoothing().data][:2] == ["measured", "smoothed"]
    assert [trace.name for trace in example.plot.free_run().data][:2] == ["measured", "simulated"]
    assert len(example.plot.errors().data) == 2
    assert len(example.plot.parameters().data[0].x) == 4


def test_wrong_names_are_answered_with_the_choices(example: dy.Identification) -> None:
    with pytest.raises(InputError, match="no log 'teusday'; did you mean 'tuesday'"):
        example.plot.torque("teusday")
    with pytest.raises(InputError, match="no joint 'sldr'; did you mean 'slider'"):
        example.plot.smoothing("tuesday", "sldr")
    still = replace(
        example, validations=tuple(replace(validation, free_run=None) for validation in example.validations)
    )
    with pytest.raises(InputError, match="no free simulation; ask for one"):
        still.plot.free_run()


def test_a_saved_result_shows_what_it_holds(example: dy.Identification, saved: dy.Identification) -> None:
    assert repr(saved).splitlines()[0] == "<Identification of 'slider'"
    assert repr(saved).splitlines()[1:] == repr(example).splitlines()[1:]
    assert "its verdict is in its report" in saved._repr_html_()
    assert saved.frame().equals(example.frame())
    assert len(saved.plot.errors().data) == 2
    with pytest.raises(InputError, match="not its signals"):
        saved.plot.torque()
