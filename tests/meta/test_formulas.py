"""The formulas of the pages can be read, and a wrong one stops the site's build."""

import re
import runpy
from pathlib import Path

import pytest

pytest.importorskip("latex2mathml", reason='the extra "docs" is not installed')
pytest.importorskip("mkdocs", reason='the extra "docs" is not installed')

from markdown import markdown
from mkdocs.exceptions import PluginError

ROOT = Path(__file__).parents[2]
HOOK = runpy.run_path(str(ROOT / "docs" / "formulas.py"))
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def formulas() -> list[tuple[str, str]]:
    result = []
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]):
        text = page.read_text(encoding="utf-8")
        prose = re.sub(r"`[^`]+`", "", FENCED.sub("", text))
        blocks = [body for kind, body in FENCED.findall(text) if kind == "math"]
        result += [(page.name, x) for x in [*blocks, *re.findall(HOOK["INLINE"], prose)]]
    return result


def test_every_formula_can_be_read() -> None:
    result = formulas()
    assert len(result) > 100
    assert {"methods_model.md", "maximum_likelihood.md", "notation.md"} <= {page for page, _ in result}
    for _, formula in result:
        assert HOOK["mathml"](formula).startswith("<math")


@pytest.mark.parametrize(
    "formula", [r"\alhpa", r"\frac{a}", r"\left( a", "{a", "a}", "x_", "a_b_c", r"\begin{matrix} a"]
)
def test_a_wrong_formula_is_refused(formula: str) -> None:
    with pytest.raises(PluginError, match="cannot be read"):
        HOOK["mathml"](formula)


def test_dollars_of_text_and_code_are_kept() -> None:
    shown = markdown(r"`$a$`, from $5 to $6, and $a_1 < \{b\}$ with $c_1$.", extensions=[HOOK["Formulas"]()])
    assert shown.count("<math") == 2
    assert "<code>$a$</code>, from $5 to $6" in shown
    assert "<em>" not in shown


def test_a_function_stands_apart_from_its_argument_but_not_from_a_bracket() -> None:
    assert "<mi>log</mi><mspace" in HOOK["mathml"](r"\log p")
    assert "<mi>diag</mi><mo" in HOOK["mathml"](r"\operatorname{diag}(\delta)")
