"""Edits change the bytes they name, and no others."""

import pytest

from dynident.files.xml_text import XmlText

TEXT = """<?xml version="1.0"?>
<!-- <a b="1"> -->
<a>
    <b one = '1' two="x>y"/>
    <é name="ü"><c/></é>
    <d
       long="3" >text</d >
</a>
"""


def child(text, tag):
    return next(node for node in text.root.walk() if node.tag == tag)


def test_nothing_changes_without_an_edit():
    assert str(XmlText(TEXT)) == TEXT


def test_attributes_are_replaced_and_added():
    text = XmlText(TEXT)
    text.set(child(text, "b"), {"two": '"&', "three": "3"})
    text.set(child(text, "d"), {"new": "4", "long": "5"})
    text.set(child(text, "c"), {"x": "0"})
    expected = TEXT.replace('"x>y"', '\'"&amp;\' three="3"').replace('long="3"', 'long="5" new="4"')
    assert str(text) == expected.replace("<c/>", '<c x="0"/>')


def test_attributes_are_dropped():
    text = XmlText(TEXT)
    text.drop(child(text, "b"), ("one", "none"))
    assert str(text) == TEXT.replace(" one = '1'", "")


@pytest.mark.parametrize(
    ("tag", "old", "new"),
    [
        ("b", "\n    <b one = '1' two=\"x>y\"/>", ""),
        ("é", '\n    <é name="ü"><c/></é>', ""),
        ("d", '\n    <d\n       long="3" >text</d >', ""),
    ],
)
def test_elements_are_deleted_and_replaced(tag, old, new):
    text = XmlText(TEXT)
    text.delete(child(text, tag))
    assert str(text) == TEXT.replace(old, new)
    text = XmlText(TEXT)
    text.replace(child(text, tag), "<new/>")
    assert str(text) == TEXT.replace(old, "\n    <new/>")


def test_elements_are_inserted_with_the_indentation_of_their_siblings():
    text = XmlText(TEXT)
    text.insert(text.root, "<x>", "  <y/>", "</x>")
    text.insert(child(text, "b"), "<z/>")
    expected = TEXT.replace("<a>\n", "<a>\n    <x>\n      <y/>\n    </x>\n", 1)
    assert str(text) == expected.replace('two="x>y"/>', 'two="x>y">\n      <z/>\n    </b>')


def test_line_ends_are_kept():
    text = XmlText(TEXT.replace("\n", "\r\n"))
    text.insert(child(text, "b"), "<z/>")
    assert str(text).count("\n") == str(text).count("\r\n") == TEXT.count("\n") + 2
