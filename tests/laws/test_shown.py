"""What pages, terminal tables and sentences show stays, down to columns, order, digits and looks of figures."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynident.files.results import json_text
from dynident.report import page
from dynident.report.figures import CLOCK_RANGE
from dynident.report.page import PageTable
from tests.kept import check_kept, page_text
from tests.sweeps import sweep


def rankings() -> str:
    from dynident.apps.ranking.page import ranking_page
    from tests.report.rankings import ranking

    return ranking_page(ranking())


def fleets() -> str:
    from dynident.apps.fleets.report import fleet_page
    from tests.report.fleets import fleet

    return fleet_page(fleet(4, 8))


def study() -> str:
    from dynident.apps.article import study_page
    from tests.report.conftest import Reproduction, cases, motion

    return study_page(Reproduction(tuple(cases()), {"simulated": motion(start=0.0), "spline": motion(noise=0.05)}))


def excitation() -> str:
    from dynident.apps.excitation.report import excitation_page
    from tests.report.designs import designed

    return excitation_page(*designed(), (("two.csv", "the motion"),))


def identification() -> str:
    from dynident.report.identification import identification_page
    from tests.report.conftest import identification_of

    runs = tuple(free_run(name, failure) for name, failure in (("swing.csv", ""), ("reach.csv", "it runs away")))
    return identification_page(identification_of()) + "\n".join(simulations(identification_of(), runs))


def free_run(name: str, failure: str) -> SimpleNamespace:
    t, figures = np.linspace(0.0, 4.0, 101), {"shoulder": 1.23456, "elbow": 0.0123456}
    measured = np.sin(t)[:, None] * [1.0, 0.5]
    return SimpleNamespace(
        name=name, joints=tuple(figures), driver="controller", restart=0.5 if failure else None, t=t,
        q=measured + 0.1, measured=measured, failure=failure, relative_error=figures, motion_error=figures,
        rms=figures, torque_error={"shoulder": 2.34567},
    )  # fmt: skip


def simulations(result: Any, runs: tuple[SimpleNamespace, ...]) -> Iterator[str]:
    """The sections of free simulations where one has failed, where none has, and where there is none."""
    from dynident.report.identification.validation import simulation_section

    for some in (runs, runs[:1], ()):
        result.runs = some
        yield page.render("", "", list(simulation_section(result)))


def robot() -> str:
    from dynident.report.identification import identification_page
    from tests.report.robots import identified

    return identification_page(identified())


def comparison() -> str:
    from dynident.apps.compare_results import compare_results
    from dynident.apps.compare_results.report import comparison_page
    from tests.apps.compare_results.test_comparison import FIRST_FULL, WORSE

    return comparison_page([compare_results(FIRST_FULL, WORSE), compare_results(FIRST_FULL, FIRST_FULL)])


def payload() -> str:
    from dynident.apps.payload.report import payload_page
    from tests.apps.payload.arms import result
    from tests.apps.payload.test_report import weighed

    return payload_page(weighed(), result())


def bound() -> str:
    from dynident.apps.bound import bound_page
    from tests.apps.test_bound import arm_bound

    return bound_page(arm_bound())


def servo() -> str:
    from dynident.apps.servo.report import servo_page
    from tests.apps.servo.made import identified

    return servo_page(identified())


def smoothing() -> str:
    from dynident.motion.splines import smooth
    from dynident.report.identification.validation import smoothing_page
    from tests.report.conftest import motion

    made = motion(n=200)
    return smoothing_page("run.csv", made.joints, made.q, smooth(made.t, made.q, sigma=1e-3))


PAGES = (rankings, fleets, study, excitation, identification, robot, comparison, payload, bound, servo, smoothing)


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_a_page_shows_what_it_showed(make: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "plotly_packed", lambda: "-")  # its cache would keep a source without a script
    check_kept(f"page_{make.__name__}", page_text(make()))


def table_lines(tables: Iterable[PageTable]) -> Iterator[str]:
    for table in tables:
        yield f"{table.caption}: {' | '.join(column.title for column in table.columns)}"
        yield from (" | ".join(row) for row in table.rows)


def ranking_lines() -> Iterator[str]:
    from dynident.apps.ranking import differences, report
    from dynident.apps.ranking import ranking as nouns
    from tests.report.rankings import ranking

    def show(noun: nouns.Ranking) -> list[str]:
        heading, tables = report.ranking_heading(noun), table_lines(report.ranking_tables(noun))
        return [heading, *report.ranking_findings(noun), *tables]

    made = ranking()
    same = [replace(row, cross_p_value=1.0) for row in made.rows]
    for noun in (made, replace(made, rows=tuple(same[:2]), basis="train")):
        yield from sweep(noun, show, (report, nouns, differences), depth=2)
    yield json_text(report.ranking_dict(made))


def fleet_lines() -> Iterator[str]:
    from dynident.apps.fleets import Changes, changes_report, report
    from tests.report.fleets import fleet

    made = fleet(2, 4)

    def show(noun: Changes) -> list[str]:
        changed = replace(made, changes=(noun,))
        return [*report.fleet_findings(changed), *table_lines(report.fleet_tables(changed))]

    yield from sweep(made.changes[0], show, (changes_report,), depth=1)


def comparison_lines() -> Iterator[str]:
    from dynident.apps.compare_results import comparison as nouns
    from dynident.apps.compare_results import report
    from tests.apps.compare_results.test_comparison import FIRST_FULL, WORSE

    def show(noun: nouns.ResultComparison) -> list[str]:
        tables = (*report.comparison_tables(noun), report.overview_table((noun.first, noun.second)))
        return [report.headline(noun), *report.comparison_lines(noun), *table_lines(tables)]

    made = nouns.compare_results(FIRST_FULL, WORSE)
    yield from sweep(made, show, (report, nouns), depth=2)
    yield json_text(report.comparison_dict([made]))


def payload_lines() -> Iterator[str]:
    from dynident.apps.payload import report
    from tests.apps.payload.test_report import weighed

    def show(noun: Any) -> list[str]:
        tables = (report.payload_table(noun), report.shares_table(noun), *report.torque_table(noun))
        return [report.payload_words(noun), *table_lines((*tables, *report.gains_table(noun)))]

    yield from sweep(weighed(), show, (report,), depth=1)


def check_lines() -> Iterator[str]:
    from dynident.checks import ChannelFacts, CheckResult
    from dynident.report import check

    fact = ChannelFacts("a", 1.23456, 1e-4, 1e-5, 0.0, 0.0, 3.45678, 0.123456, 0.01)
    made = CheckResult((), channels={"one": (fact,)})
    yield from sweep(fact, lambda noun: list(table_lines(check.check_tables(replace(made, channels={"one": (noun,)})))))


def study_lines() -> Iterator[str]:
    from dynident.apps.article import findings, report, study_tables
    from tests.report.conftest import Reproduction, cases

    def show(noun: Reproduction) -> list[str]:
        return [*findings(noun), *table_lines(study_tables(noun))]

    yield from sweep(Reproduction(tuple(cases(4))), show, (report,), depth=1)


def excitation_lines() -> Iterator[str]:
    from dynident.apps.excitation import expected_report, report
    from tests.report.designs import designed

    project, made = designed()

    def show(noun: Any) -> list[str]:
        tables = table_lines([report.limit_use_table(noun)])
        return [report.excitation_heading(noun), *report.excitation_findings(project, noun), *tables]

    yield from sweep(made, show, (expected_report, report), depth=1)


def servo_lines() -> Iterator[str]:
    from dynident.apps.servo import judge, report
    from tests.apps.servo.made import identified

    def show(noun: Any) -> list[str]:
        tables = report.parameter_table(noun), report.rollout_table(noun)
        return [report.verdict_words(noun), *report.suspect_lines(noun), *noun.warnings, *table_lines(tables)]

    yield from sweep(identified(), show, (judge, report), depth=1)
    yield json_text(report.servo_dict(identified()))


def bound_lines() -> Iterator[str]:
    from dynident.apps import bound as module
    from tests.apps.test_bound import arm_bound

    def show(noun: Any) -> list[str]:
        return [*module.bound_findings(noun), *table_lines([module.bound_table(noun)])]

    yield from sweep(arm_bound(), show, (module,), depth=1)


def watch_lines() -> Iterator[str]:
    from dynident.apps.online import report
    from dynident.apps.online.watcher import WatchSettings

    yield from sweep(WatchSettings(), lambda noun: [report.watch_words(noun)], (report,))
    yield from (
        report.stamp_text(t, zero) for t in (math.nan, 12.34, 1.7e9, *CLOCK_RANGE) for zero in (math.nan, 1.6e9)
    )


SWEEPS = (
    ranking_lines, fleet_lines, comparison_lines, payload_lines, check_lines, study_lines, excitation_lines,
    servo_lines, bound_lines, watch_lines,
)  # fmt: skip


@pytest.mark.parametrize("lines", SWEEPS, ids=lambda lines: lines.__name__)
def test_tables_and_findings_follow_each_figure(lines: Callable[[], Iterator[str]]) -> None:
    check_kept(lines.__name__, "\n".join(lines()))
