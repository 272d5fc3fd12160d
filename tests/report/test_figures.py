import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.apps.article import figures as study_figures
from dynident.motion.log import Log, Motion
from dynident.report import figures as canvas
from dynident.report.identification import figures as drawings
from dynident.runtime import InputError

DRAWN = {
    name: value
    for name, value in (vars(canvas) | vars(study_figures) | vars(drawings)).items()
    if name.endswith("_figure")
}
figures = SimpleNamespace(  # as plotly for Python takes them, which checks every property
    **vars(canvas)
    | vars(study_figures)
    | vars(drawings)
    | {name: lambda *args, draw=draw, **more: draw(*args, **more).figure() for name, draw in DRAWN.items()}
)
QUARTILES = [0, 0.25, 0.5, 0.75, 1]


def motion(mask=None, n=400, spike=None, joints=("joint1", "joint2")):
    t = np.linspace(0.0, 10.0, n)
    angle = np.outer(t, np.ones(len(joints))) + np.arange(len(joints))
    ddq, tau = -np.sin(angle), np.cos(angle)
    if spike is not None:
        tau[spike, 0] = ddq[spike, 0] = 50.0
    mask = np.ones(n, bool) if mask is None else mask(t)
    return Motion(t, np.sin(angle), np.cos(angle), ddq, tau, joints, mask, "run.csv")


def validation(held):
    return SimpleNamespace(motion=held, predicted_torque=held.tau + 0.25)


def study(estimates, levels=(1e-6,), methods=("raw",)):
    cases = tuple(SimpleNamespace(sigma_q2=s, method=m, estimates=estimates) for s in levels for m in methods)
    return SimpleNamespace(cases=cases, names=("theta1", "theta2"), true=np.array([2.0, -4.0]))


@pytest.mark.parametrize("n", [2001, 4000, 6001, 99_991])
def test_thin_keeps_ends_extremes_and_order(n):
    rng = np.random.default_rng(n)
    t, y = np.sort(rng.random(n)), rng.standard_normal(n)
    thin_t, thin_y = figures.thin(t, y, 2000)
    assert 1000 < len(thin_t) <= 2000
    assert (np.diff(thin_t) > 0).all()
    assert (thin_t[0], thin_t[-1]) == (t[0], t[-1])
    assert (thin_y.min(), thin_y.max()) == (y.min(), y.max())
    assert np.isin(thin_t, t).all()
    np.testing.assert_array_equal(thin_y, y[np.searchsorted(t, thin_t)])


@pytest.mark.parametrize("hole", [slice(0, 3000), slice(4000, 4700), slice(9000, 10_000)])
def test_thin_keeps_gaps_open(hole):
    t, y = np.arange(10_000.0), np.sin(np.arange(10_000) / 300)
    y[hole] = np.nan
    thin_t, thin_y = figures.thin(t, y, 600)
    inside = (thin_t >= hole.start) & (thin_t < hole.stop)
    assert len(thin_t) <= 600
    assert inside.any()
    np.testing.assert_array_equal(np.isnan(thin_y), inside)
    assert (np.nanmin(thin_y), np.nanmax(thin_y)) == (np.nanmin(y), np.nanmax(y))


def test_thin_leaves_short_curves_alone_and_rejects_too_few_points():
    t, y = np.arange(50.0), np.arange(50.0)
    assert figures.thin(t, y, 50)[1] is y
    with pytest.raises(InputError, match="to 7 points; ask for at least 8"):
        figures.thin(t, y, 7)
    assert np.isnan(figures.thin(t, np.full(50, np.nan), 8)[1]).all()


def test_trace_figure_ranges_over_what_every_method_may_use():
    """A distortion before the clipped part, or in the raw differences, does not flatten the rest."""
    wild = motion(lambda t: t >= 1.75, spike=10)
    figure = figures.trace_figure({"simulated": motion(), "filtered": wild, "raw": motion(spike=300)}, 0, "ddq")
    low, high = figure.layout.yaxis.range
    assert -2.0 < low < -1.0
    assert 1.0 < high < 2.0
    empty = figures.trace_figure({"simulated": motion(lambda t: t < 0)}, 0, "dq")
    assert empty.layout.yaxis.range is None
    apart = {"simulated": motion(lambda t: t < 2), "filtered": motion(lambda t: t > 8)}
    assert figures.trace_figure(apart, 0, "dq").layout.yaxis.range is None


def test_spread_figure_of_many_runs_keeps_quartiles_and_extremes():
    many = np.random.default_rng(0).normal(size=(5000, 2))
    box = figures.spread_figure(study(many)).data[0]
    values = box.customdata[: len(box.y) // 2, 0]
    assert len(values) == study_figures.MAX_RUNS
    np.testing.assert_allclose(np.quantile(values, QUARTILES), np.quantile(many[:, 0], QUARTILES), rtol=1e-5)


def test_torque_figure_keeps_a_spike_of_one_sample():
    figure = figures.torque_figure(validation(motion(n=60_000, spike=12_345)), "joint1", points=300)
    assert max(len(trace.y) for trace in figure.data) <= 300
    assert np.nanmax(figure.data[0].y) == 50.0


def test_figures_name_the_joints_to_choose_from():
    message = "run.csv: no joint 'joint3'; did you mean .* Choose from 'joint1', 'joint2'"
    with pytest.raises(InputError, match=message):
        figures.motion_figure(motion(), "joint3")
    with pytest.raises(InputError, match=message):
        figures.torque_figure(validation(motion()), "joint3")


def intervals(std, units=("kg", "kg", "N m"), true=(), names=("a", "b", "c")):
    return figures.interval_figure(names, units, np.array([1.0, -2.0, 3.0]), np.array(std), true)


def test_names_cannot_carry_tags_into_a_figure():
    figure = intervals([1, 1, 1], ("<b>kg", "m", "m"), names=("<a href='x'>", "b", "c"))
    assert figure.layout.yaxis.ticktext[0] == "&lt;a href='x'&gt;"
    assert figure.data[0].text[0].startswith("&lt;a")
    assert "&lt;b&gt;kg" in figure.data[0].text[0]
    assert "<b>" not in figures.trace_figure({"<b>": motion()}, 0, "dq").data[0].name
    log = SimpleNamespace(name="<b>", role="train", errors=SimpleNamespace(per_joint={"<i>": 1.0}))
    bar = figures.error_figure([log], ["<i>"]).data[0]
    assert (bar.name, bar.y[0]) == ("&lt;b&gt; (training)", "&lt;i&gt;")


@pytest.mark.parametrize("time_offset", [0.0, 0.07])
def test_motion_figure_shows_what_smoothing_took_away(time_offset):
    """Measured positions belong ``time_offset`` before their stamps: the difference is then the noise and nothing
    else."""
    t = np.linspace(0.0, 10.0, 4000)
    truth = Motion(t, *(f(t)[:, None] for f in (np.sin, np.cos, lambda x: -np.sin(x), np.cos)), ("x",), t < 9)
    noise = 1e-3 * np.random.default_rng(2).standard_normal((len(t), 1))
    log = Log(t, truth.q + noise, truth.tau, ("x",))
    figure = figures.motion_figure(truth.shift(time_offset), "x", "m", 10_000, log)
    left = next(trace for trace in figure.data if "minus" in trace.name)
    shown = np.isfinite(left.y)
    assert shown.sum() > 3000
    np.testing.assert_allclose(left.x, t - time_offset, atol=1e-6)
    np.testing.assert_allclose(left.y[shown], noise[shown, 0], atol=1e-6)
    assert [figure.layout[f"yaxis{k}"].title.text for k in ("", 2, 3, 4)] == [
        "position, m", "taken away, m", "velocity, m/s", "acceleration, m/s²",
    ]  # fmt: skip


def free_run(restart, q=None):
    t = np.linspace(0.0, 4.0, 401)
    measured = np.sin(t)[:, None]
    q = measured + 0.1 if q is None else q
    if restart:
        q[::50] = measured[::50]
    return SimpleNamespace(name="run", joints=("x",), restart=restart, t=t, q=q, measured=measured)


def test_run_figure_breaks_where_the_simulation_starts_anew():
    figure = figures.run_figure(free_run(0.5), "x")
    simulated, error = figure.data[1], figure.data[2]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(simulated.y)), np.arange(0, 401, 50))
    np.testing.assert_allclose(error.y[np.isfinite(error.y)], -0.1, rtol=1e-5)
    assert np.isfinite(figures.run_figure(free_run(None), "x").data[1].y).all()
    assert np.isnan(figures.run_figure(free_run(None, np.full((401, 1), np.inf)), "x").data[1].y).all()
    with pytest.raises(InputError, match="run: no joint 'z'"):
        figures.run_figure(free_run(None), "z")


def test_stamps_far_from_zero_are_counted_from_the_first():
    early = motion()
    delayed = replace(early, t=early.t + 1.7e9)
    for case, zero, title in ((early, 0.0, "time, s"), (delayed, 1.7e9, "time since 2023-11-14 22:13:20 UTC, s")):
        figure = figures.torque_figure(validation(case), "joint1")
        np.testing.assert_allclose(figure.data[0].x, case.t - zero, atol=1e-5)
        assert figure.layout.xaxis2.title.text == title


def test_a_drawing_is_written_as_plotly_writes_its_figure():
    """Arrays of every type and shape, and numbers that JSON does not know."""
    drawing = canvas.panels(["a", "b"], 400, ["above", "below"], heights=[0.7, 0.3])
    for k, values in enumerate(
        (
            np.linspace(0, 1, 5), np.arange(5, dtype=np.float32), np.arange(5), np.arange(5) - 300,
            np.arange(5) * 10**5, np.arange(5) * 10**12, np.full((5, 2), 0.5), np.array([True, False]),
            np.array([]), [1.0, np.nan, np.inf],
            [np.float64(2.0)], ("x", "y"), np.array([-128, 127]), np.array([128]),
        )
    ):  # fmt: skip
        drawing.add(canvas.trace("scatter", customdata=values, name=f"{k} <b>", meta=None, x=[k]), row=1 + k % 2)
    drawing.axes("y", type="log", range=None)
    mine, theirs = json.loads(drawing.json()), json.loads(drawing.figure().to_json())
    assert mine == theirs
    assert "meta" not in mine["data"][0]
    assert [x["yaxis"] for x in mine["data"][:2]] == ["y", "y2"]
