import json
import re
import zlib
from base64 import b64decode
from html.parser import HTMLParser

import pytest
from plotly.offline import get_plotlyjs

from dynident.report import Drawing
from dynident.report.figures import trace
from dynident.report.page import (
    Badge,
    Code,
    Column,
    Facts,
    Figure,
    Fold,
    Gallery,
    PageSection,
    PageTable,
    plotly_packed,
    relative_link,
    render,
)
from dynident.runtime import InputError, number

EVIL = "</script><script>alert(1)</script><b>\u2028&"
VOID = {"meta", "br", "hr", "img", "link", "input", "wbr"}


class Outline(HTMLParser):
    """Collects the tags and the texts of scripts; fails where an element is not closed."""

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.scripts = [], [], []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1] += data

    def count(self, tag):
        return sum(name == tag for name, _ in self.tags)


def figure(name="y"):
    return Figure(Drawing([trace("scatter", x=[0, 1], y=[0, 1], name=name)], {"height": 300}), name)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (-0.000451, 4, "-0.0004510"),
        (1e-4, 4, "0.0001000"),
        (0.99e-4, 4, "9.900e-5"),
        (99999.4, 4, "99999"),
        (99999.6, 4, "100000"),
        (1e5, 4, "1.000e5"),
        (9.9996, 4, "10.00"),
        (143.7, 2, "144"),
        (-0.0, 4, "0"),
        (None, 4, "-"),
        (float("nan"), 4, "-"),
        (float("inf"), 4, "∞"),
        (float("-inf"), 4, "-∞"),
    ],
)
def test_number(value, digits, text):
    assert number(value, digits) == text


def test_a_row_that_does_not_fit_is_named():
    with pytest.raises(ValueError, match="Table 'errors': row 1 has 1 cells for 2 columns"):
        PageTable((Column("a"), Column("b")), (("1", "2"), ("1",)), "errors")


def test_plotly_is_embedded_once_only_where_there_is_a_figure_and_the_network_is_asked_for_nothing():
    page = render("t", "l", [PageSection("s", (figure(), PageSection("inner", (figure(),))))])
    outline, packed = Outline(page), plotly_packed()
    assert page.count(packed) == 1
    assert zlib.decompress(b64decode(packed)).decode() == get_plotlyjs()
    assert len(packed) < 0.45 * len(get_plotlyjs())
    assert outline.count("figure") == 2
    assert not re.search(r"https?:|//[a-z]|@import|url\(", page.replace(packed, ""))
    assert all("src" not in attrs and tag != "link" for tag, attrs in outline.tags)
    (policy,) = (attrs for _, attrs in outline.tags if attrs.get("http-equiv") == "Content-Security-Policy")
    assert policy["content"].startswith("default-src 'none'")
    without = render("t", "l", [PageSection("s", ("text",))])
    assert len(without) < 20_000
    assert Outline(without).scripts == []


def test_names_cannot_break_out_of_texts_tables_and_figures():
    table = PageTable((Column(EVIL, EVIL, numeric=False),), ((EVIL,),), EVIL)
    quoted = f"`{EVIL}`"
    blocks = (EVIL, (quoted,), Facts(((EVIL, EVIL, quoted),)), table, figure(EVIL), PageSection(EVIL, (EVIL,)))
    blocks += (Fold(EVIL, (Code(EVIL),)), Gallery((EVIL,), (((EVIL,), (EVIL,)), ((quoted,), (quoted,)))))
    page = render(EVIL, EVIL, [PageSection(EVIL, blocks, Badge(EVIL, "bad"))])
    outline = Outline(page)
    assert outline.count("script") == 3
    assert outline.count("b") == 0
    data = json.loads(outline.scripts[1])
    assert data["data"][0]["name"] == EVIL
    assert "\u2028" not in outline.scripts[1]


def test_without_plotly_and_outside_a_wheel_the_package_is_named(monkeypatch):
    monkeypatch.setattr("dynident.report.page.find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install plotly"):
        plotly_packed.__wrapped__()


@pytest.mark.parametrize(
    ("path", "link"),
    [
        ("runs/arm/1/report.html", "./runs/arm/1/report.html"),
        ("arm=201/a b#c?.html", "./arm%3D201/a%20b%23c%3F.html"),
        ("javascript:alert(1)", "./javascript%3Aalert%281%29"),
        ('"><script>/\udc80', "./%22%3E%3Cscript%3E/%3F"),
        ("//host/page", ""),
        ("/etc/passwd", ""),
        ("a/../../b", ""),
        ("", ""),
    ],
)
def test_links_stay_below_the_page(path, link):
    assert relative_link(path) == link


def test_the_first_cell_of_a_row_leads_to_its_link():
    heads = (Column("log", numeric=False), Column("error"))
    table = PageTable(heads, ((EVIL, "-1"), ("b", "2")), links=("./a", ""))
    outline = Outline(render("t", "", [PageSection("s", (table,))]))
    links = [attrs["href"] for tag, attrs in outline.tags if tag == "a"]
    assert links == ["#part-1", "./a"]
    assert outline.count("script") == 1  # which sorts and copies tables
    with pytest.raises(ValueError, match="1 links for 2 rows"):
        PageTable(heads, (("a", "1"), ("b", "2")), links=("./a",))
