"""Tables in a terminal of any width."""

import io
import random

import pytest
import rich.console
from rich.cells import cell_len

from dynident.report.page import Column, PageTable
from dynident.report.terminal import TerminalTable

JOINTS = tuple(f"robot_cell_left_manipulator_arm_joint_{k}_x" for k in range(7))
WORDS = Column("joint", numeric=False)


def printed(table, width=80):
    console = rich.console.Console(width=width, file=io.StringIO(), color_system=None)
    console.print(TerminalTable(table))
    return console.file.getvalue()


def numbers(count, group=""):
    return tuple(Column(f"value {k}", group) for k in range(count))


def test_a_group_stands_once_above_its_columns():
    columns = (WORDS, Column("peak", "acceleration"), Column("rms", "acceleration"), Column("turns"))
    head = printed(PageTable(columns, (("elbow", "12.25", "1.125", "3"),))).splitlines()[:2]
    assert head == ["       acceleration", "joint   peak    rms  turns"]
    columns = (WORDS, Column("a"), Column("b", "g"), Column("c", "g"))
    shown = printed(PageTable(columns, (("elbow", *("12345",) * 3),)), 19)  # the group fits, and would be torn beside a
    assert [line.split() for line in shown.splitlines() if line.startswith("joint")] == [
        ["joint", "a"],
        ["joint", "b", "c"],
    ]


@pytest.mark.parametrize("width", [40, 60, 80, 150])
@pytest.mark.parametrize("count", [1, 4, 12])
def test_every_number_is_shown_in_any_width(width, count):
    rng = random.Random(width * count)
    rows = tuple((name, *(f"{rng.uniform(-1e4, 1e4):.2f}" for _ in range(count))) for name in JOINTS)
    shown = printed(PageTable((WORDS, *numbers(count, "speed")), rows), width)
    assert max(map(cell_len, shown.splitlines())) <= width
    for row in rows:
        for cell in row[1:]:
            assert cell in shown.split()


@pytest.mark.parametrize("width", range(20, 60))
def test_no_number_beside_two_columns_of_names_is_cut(width):
    columns = (WORDS, Column("type", numeric=False), *numbers(2))
    rows = tuple((name, "continuous", "1.235e+08", "-0.001235") for name in JOINTS)
    shown = printed(PageTable(columns, rows), width)
    assert max(map(cell_len, shown.splitlines())) <= width
    assert shown.split().count("1.235e+08") == shown.split().count("-0.001235") == len(JOINTS)


def test_long_names_stay_distinct():
    rows = tuple((name, "log.csv 0-10 s", "1.25", "N m") for name in JOINTS)
    columns = (WORDS, Column("log", numeric=False), *numbers(1), Column("unit", numeric=False))
    shown = printed(PageTable(columns, rows), 44).splitlines()[3:10]
    assert len({line.split()[0] for line in shown}) == len(JOINTS)
    assert all(line.endswith("N m") for line in shown)


def test_titles_wrap_and_wide_letters_count_as_two_cells():
    columns = (WORDS, Column("longest step between neighbouring samples, ms"), *numbers(3))
    shown = printed(PageTable(columns, (("関節" * 10, *("123456.5",) * 4),)), 60)
    assert max(map(cell_len, shown.splitlines())) <= 60
    assert shown.count("123456.5") == 4
    assert "neighbouring" in shown
