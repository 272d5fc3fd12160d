"""Colours of figures: told apart by everybody, and seen on both papers."""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest

from dynident.report.figures import AMBER, BLUE, GREEN, RED, VIOLET

PALETTE = {"blue": BLUE, "red": RED, "green": GREEN, "amber": AMBER}
# linear RGB as people without one kind of cones see it: G. M. Machado et al., "A physiologically-based model for
# simulation of color vision deficiency", IEEE Trans. Vis. Comput. Graph. 15 (2009), severity 1
SIGHT = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
# B. Ottosson, "A perceptual color space for image processing" (Oklab), 2020
CONES = [
    [0.41222147, 0.53633254, 0.05144599],
    [0.21190350, 0.68069955, 0.10739696],
    [0.08830246, 0.28171884, 0.62997870],
]
LAB = [
    [0.21045426, 0.79361779, -0.00407205],
    [1.97799850, -2.42859221, 0.45059371],
    [0.02590404, 0.78277177, -0.80867577],
]


def linear(colour: str) -> np.ndarray:
    values = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def contrast(name: str, other: str) -> float:
    """The ratio of luminances of WCAG 2."""
    low, high = sorted(float(linear(colour) @ (0.2126, 0.7152, 0.0722)) for colour in (name, other))
    return (high + 0.05) / (low + 0.05)


def seen(colour: str, sight: str) -> np.ndarray:
    return np.array(LAB) @ np.cbrt(CONES @ np.clip(SIGHT[sight] @ linear(colour), 0, 1))


def schemes() -> tuple[dict[str, str], dict[str, str]]:
    """The colours of the page by name, light and dark."""
    text = files("dynident.report").joinpath("templates", "page.css").read_text()
    matches = re.findall(r"--(\w+): light-dark\((#\w{6}), (#\w{6})\)", text)
    return {name: light for name, light, _ in matches}, {name: dark for name, _, dark in matches}


def on_dark(colour: str) -> str:
    """A colour as the styles of the page turn it on dark paper: ``hue-rotate`` of W3C Filter Effects."""
    text = files("dynident.report").joinpath("templates", "page.css").read_text()
    (match,) = re.findall(r"filter: invert\(1\) hue-rotate\((\d+)deg\) brightness\(([\d.]+)\)", text)
    angle, brightness = np.deg2rad(float(match[0])), float(match[1])
    grey = np.array([0.213, 0.715, 0.072])
    sine = [[-0.213, -0.715, 0.928], [0.143, 0.140, -0.283], [-0.787, 0.715, 0.072]]
    turn = grey + np.cos(angle) * (np.eye(3) - grey) + np.sin(angle) * np.array(sine)
    inverse = 1 - np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    turned = np.clip(np.clip(turn @ inverse, 0, 1) * brightness, 0, 1)
    return "#" + "".join(f"{round(255 * x):02x}" for x in turned)


def nearest(colours: list[str], sight: str) -> float:
    return min(float(np.linalg.norm(seen(a, sight) - seen(b, sight))) for a, b in combinations(colours, 2))


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_curves_are_told_apart(sight: str) -> None:
    assert nearest(list(PALETTE.values()), sight) > 0.11
    assert nearest([on_dark(colour) for colour in PALETTE.values()], sight) > 0.11
    assert nearest(["#2e9e5b", "#e5484d"], "deuteranopia") < 0.05  # a green and a red


def test_curves_are_seen_on_both_papers() -> None:
    light, dark = (scheme["paper"] for scheme in schemes())
    for colour in (*PALETTE.values(), VIOLET):
        assert min(contrast(colour, light), contrast(colour, dark)) >= 3.0, colour  # in scenes, which are not turned
        assert contrast(on_dark(colour), dark) >= 4.5, colour
    assert contrast(on_dark("#111111"), dark) > 10


def test_texts_are_read_in_both_schemes() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    for scheme in schemes():
        for name in ("ink", "soft", "accent", "good", "fair", "bad"):
            assert contrast(scheme[name], scheme["paper"]) >= 4.5, name
        for name in ("ink", "soft", "accent"):
            assert contrast(scheme[name], scheme["panel"]) >= 4.5, name
