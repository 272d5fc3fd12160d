"""Tables and sentences of ``dynident payload``: what the arm carries, how well it is known, and by what."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynident.apps.payload.body import Component, NoPayload, mass_bound
from dynident.apps.payload.estimate import ErrorSource
from dynident.apps.payload.payload import Payload
from dynident.files.meshes import result_geometry
from dynident.identification import Identification
from dynident.identification.links import body_inertia, rigid_bodies
from dynident.models import INERTIAL
from dynident.report import Drawing
from dynident.report.figures import AMBER, BLUE, GREEN, INK, RED, VIOLET, panels, trace
from dynident.report.identification.robot import payload_view
from dynident.report.page import UNIT, Beside, Facts, Figure, PageBlock, PageSection, PageTable, pair_table, render
from dynident.runtime import capitalise, number, number_within

SOURCE_COLOURS = {
    ErrorSource.ARM: BLUE, ErrorSource.LOADED: GREEN, ErrorSource.UNLOADED: GREEN, ErrorSource.DRIFT: AMBER,
    ErrorSource.FRICTION: RED, ErrorSource.GAINS: VIOLET, ErrorSource.PRIOR: INK,
}  # fmt: skip
HATCHED_SOURCES = (ErrorSource.UNLOADED,)
MIN_SHOWN_SHARE = 0.005  # share of the variance, below which a source is not named

_METHOD_NOTE = (
    "Payload, drift and gains are solved for together by generalised least squares. All that is known of the arm "
    "counts with its covariance; errors are standard errors, 1.96 of which hold 95 %."
)


def payload_figure(payload: Payload) -> Drawing:
    """Draw the shares of each source in the variance of each component, in %."""
    figure = panels([""], 360, shared=False)
    for source, share in payload.shares.items():
        marker = {"color": SOURCE_COLOURS[source], "pattern": {"shape": "/" if source in HATCHED_SOURCES else ""}}
        bars = trace(
            "bar", x=list(Component), y=100 * np.asarray(share), name=source.words,
            marker=marker, hovertemplate="%{y:.3g} %",
        )  # fmt: skip
        figure.add(bars)
    figure.axes("y", title="share of the variance, %", range=[0, 100])
    figure.axes("x", type="category")
    figure.layout.update(barmode="stack")
    return figure


def payload_words(payload: Payload) -> str:
    """Return mass and centre of mass in a sentence, or that no payload is seen."""
    if not payload.is_significant:
        return (
            f"No payload is seen on {payload.mount.frame}: {mass_bound(payload.body.mass, float(payload.body.std[0]))}."
        )
    body = payload.body
    verb = "carried" if payload.request.removed else "carries"
    mass = f"{number_within(body.mass, body.std[0])} ± {number(body.std[0], 2)} kg"
    centre = ", ".join(map(_length_text, 1e3 * body.centre, 1e3 * body.std[1:4]))
    return f"{payload.mount.frame} {verb} {mass}; centre of mass at ({centre}) mm in its frame."


def _length_text(value: float, std: float) -> str:
    """Return a length (mm) with its standard error, to 0.1 mm unless it is better known."""
    return f"{value:z.1f} ± {std:.1f}" if std >= 0.1 else f"{number_within(value, std)} ± {number(std, 2)}"


def payload_table(payload: Payload) -> PageTable:
    """Return the ten components to the digits of their standard errors, or the mass alone where none is seen."""
    body, components = payload.body, list(Component) if payload.is_significant else [Component.MASS]
    rows = [
        (name.meaning, number_within(float(value), float(std)), number(float(std), 2), name.unit)
        for name, value, std in zip(components, body.values, body.std, strict=False)
    ]
    return PageTable.of(("payload",), ("value", "std", UNIT), rows, f"Payload in the frame of {payload.mount.frame}")


def shares_table(payload: Payload) -> PageTable:
    """Return the shares of each source in the variance of mass and centre, in %."""
    components = list(Component)[: 4 if payload.is_significant else 1]
    shares = {source: share[: len(components)] for source, share in payload.shares.items()}
    rows = [
        (source.words, *(f"{100 * float(x):.0f}" for x in share))
        for source, share in shares.items()
        if (share > MIN_SHOWN_SHARE).any()
    ]
    heads = [f"{name}, %" for name in components]
    return PageTable.of(("error by",), heads, rows, "What the errors come from, in % of the variance")


def torque_table(payload: Payload) -> Iterator[PageTable]:
    """Yield the torque errors of each recording with and without the payload, where there are recordings."""
    rows = [(log.name, *(number(x, 3) for x in (log.without, log.with_payload, log.free))) for log in payload.logs]
    if rows:
        heads = ("arm alone, %", "with it, %", "own fit, %")
        yield PageTable.of(("recording",), heads, rows, "What is left of the torque")


def gains_table(payload: Payload, always: bool = False) -> Iterator[PageTable]:
    """Yield the gains of the drives, where a known mass determines them."""
    gains = payload.gains
    if not (always or payload.request.known_mass is not None):
        return
    rows = [
        (joint, number(float(factor)), number(float(std), 2), number(float(correction)))
        for joint, factor, std, correction in zip(gains.joints, gains.factor, gains.std, gains.correction, strict=True)
    ]
    heads = ("torque over the true one", "std", "multiply gain by")
    yield PageTable.of(("joint",), heads, rows, "Gains of the drives")


def payload_page(payload: Payload, arm: Identification) -> str:
    """Return a payload as one HTML page."""
    body = payload.body
    mass, std = number_within(body.mass, float(body.std[0])), number(float(body.std[0]), 2)
    bound = mass_bound(body.mass, float(body.std[0]))
    facts: list[tuple[str, ...]] = [("no payload", f"on {payload.mount.frame}", bound)]
    if payload.is_significant:
        distance, error = 1e3 * float(np.linalg.norm(body.centre)), 1e3 * float(body.std[1:4].max())
        facts = [
            (f"{mass} kg", f"mass, ± {std} kg"),
            (f"{number_within(distance, error)} mm", f"centre of mass from {payload.mount.frame}"),
            (f"{number(error, 2)} mm", "largest standard error of the centre"),
        ]
    notes = tuple(f"{capitalise(str(note))}." for note in payload.notes if not isinstance(note, NoPayload))
    error_blocks: list[PageBlock] = [shares_table(payload)]
    if payload.is_significant:
        error_blocks.append(Figure(payload_figure(payload), "Shares of the variance of each component."))
    head: tuple[PageBlock, ...] = (payload_words(payload), payload_table(payload))
    if view := _arm_view(payload, arm):
        head = (Beside(head, (view,), "left"),)
    sections = [
        PageSection("What the arm carries", (Facts(tuple(facts)), *head, _METHOD_NOTE)),
        PageSection("Warnings", (notes or "None.",)),
        PageSection("Where the errors come from", tuple(error_blocks)),
        PageSection("Torque", tuple(torque_table(payload)) or ("Two results are compared: no recording is here.",)),
        PageSection("Gains of the drives", tuple(gains_table(payload, always=True))),
        PageSection("Settings and versions", tuple(_settings(payload, arm))),
    ]
    return render(
        f"Payload of {arm.model.name}", f"On {payload.mount.frame}, moved by {payload.mount.joint}.", sections
    )


def _arm_view(payload: Payload, arm: Identification) -> Figure | None:
    """Return the arm with the payload; None where there is none, or no robot file."""
    bodies, geometry = rigid_bodies(arm), result_geometry(arm)
    if bodies is None or geometry is None or not payload.is_significant:
        return None
    name, added = payload.mount.body, payload.mount.transform @ payload.value
    theta = added[[parameter.body == name and parameter.role in INERTIAL for parameter in arm.model.parameters]]
    place = next(k for k, body in enumerate(bodies.arm.bodies) if body.name == name)
    inertia = body_inertia(theta)
    return None if inertia is None else payload_view(bodies, geometry, place, inertia)


def _settings(payload: Payload, arm: Identification) -> Iterator[PageBlock]:
    request = payload.request
    known_mass = "" if request.known_mass is None else f"{request.known_mass:g} kg"
    gains = f"{request.gain_error:g} % uncertain" if request.gains is None else "of an earlier payload of known mass"
    yield pair_table(
        "setting",
        [
            ("frame", payload.mount.frame), ("known mass", known_mass or "none"), ("gains", gains),
            ("gains may change by", f"{request.gain_change:g} %"),
            ("friction may change by", f"{request.friction_change:g} %"),
            ("friction by the load", f"about {request.load_friction:g} % of it"),
            ("removed", "yes" if request.removed else "no"),
            ("standard errors made larger by", number(payload.factor, 3)),
        ],
    )  # fmt: skip
    sources = arm.provenance
    if sources.configuration:
        yield pair_table("configuration", [("file", sources.configuration.path)])
    yield pair_table("program", list(sources.versions.items()))
