"""The words and tables of ``dynident payload``: what the arm carries, how well it is known, and by what."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.payload import Component, Source
from dynident.payload import notes as said
from dynident.report import figures
from dynident.report.page import UNIT, Column, Facts, Figure, PageBlock, PageSection, PageTable, number, pairs, render
from dynident.report.wording import words
from dynident.report.words import percent, short

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.payload import Payload

__all__ = ["gains_table", "payload_page", "payload_table", "payload_words", "shares_table", "torque_table"]

SOURCES = {
    Source.ARM: "result of the arm",
    Source.LOADED: "recordings with the payload",
    Source.UNLOADED: "recordings without",
    Source.DRIFT: "drift",
    Source.FRICTION: "friction by the load",
    Source.GAINS: "gains",
    Source.PRIOR: "what is known of it",
}
MEANINGS = {
    Component.MASS: "mass",
    **{one: f"centre of mass, {one}" for one in (Component.X, Component.Y, Component.Z)},
    **{one: f"inertia about the centre of mass, {one[1:]}" for one in list(Component)[4:]},
}
_TOGETHER = "turn the last joints together, fast, in several postures, as `dynident excite` designs it"
LEAST = 0.005  # share of the variance, below which a source is not named

_WHAT = (
    "Payload, drift and gains are solved for together by generalised least squares. All that is known of the arm "
    "counts with its covariance; errors are standard errors, 1.96 of which hold 95 %."
)


def payload_words(found: Payload) -> str:
    """Return mass and centre of mass in a sentence, or that there is nothing."""
    if not found.seen:
        return f"No payload is seen on {found.mount.frame}: {_nothing(found.body.mass, float(found.body.std[0]))}."
    body, (x, y, z) = found.body, 1e3 * found.body.centre
    dx, dy, dz = 1e3 * body.std[1:4]
    verb = "carried" if found.request.removed else "carries"
    return (
        f"{found.mount.frame} {verb} {short(body.mass, 4)} ± {short(body.std[0], 2)} kg; centre of mass at "
        f"({x:.1f} ± {dx:.1f}, {y:.1f} ± {dy:.1f}, {z:.1f} ± {dz:.1f}) mm in its frame."
    )


def _nothing(mass: float, std: float) -> str:
    return f"its mass is {short(mass, 2)} ± {short(std, 2)} kg, so it is below {short(max(mass, 0.0) + 3 * std, 2)} kg"


def payload_table(found: Payload) -> PageTable:
    """Return the ten components with their standard errors, or the mass alone where no payload is seen."""
    body, shown = found.body, list(Component) if found.seen else [Component.MASS]
    rows = tuple(
        (MEANINGS[name], number(float(value)), number(float(std), 2), name.unit)
        for name, value, std in zip(shown, body.values, body.std, strict=False)
    )
    columns = (Column("payload", numeric=False), Column("value"), Column("std"), UNIT)
    return PageTable(columns, rows, f"Payload in the frame of {found.mount.frame}")


def shares_table(found: Payload) -> PageTable:
    """Return what the errors of mass and centre come from, in % of the variance."""
    shown = 4 if found.seen else 1
    kept = [(source, share[:shown]) for source, share in found.shares.items() if (share[:shown] > LEAST).any()]
    rows = tuple((SOURCES[source], *(f"{100 * float(x):.0f}" for x in share)) for source, share in kept)
    columns = (Column("error by", numeric=False), *(Column(f"{name}, %") for name in list(Component)[:shown]))
    return PageTable(columns, rows, "What the errors come from, in % of the variance")


def torque_table(found: Payload) -> Iterator[PageTable]:
    """Yield what is left of the torque of each recording, where there are any."""
    rows = tuple(
        (one.name, number(one.without, 3), number(one.with_payload, 3), number(one.free, 3)) for one in found.logs
    )
    columns = (Column("recording", numeric=False), *map(Column, ("arm alone, %", "with it, %", "own fit, %")))
    if rows:
        yield PageTable(columns, rows, "What is left of the torque")


def gains_table(found: Payload, always: bool = False) -> Iterator[PageTable]:
    """Yield the gains of the drives, where a known mass tells them."""
    gains = found.gains
    if not (always or found.request.known_mass is not None):
        return
    rows = tuple(
        (joint, number(float(factor)), number(float(std), 2), number(float(correction)))
        for joint, factor, std, correction in zip(gains.joints, gains.factor, gains.std, gains.correction, strict=True)
    )
    columns = (Column("joint", numeric=False), *map(Column, ("torque over the true one", "std", "multiply gain by")))
    yield PageTable(columns, rows, "Gains of the drives")


def payload_page(found: Payload, arm: Identification) -> str:
    """Return a payload as one HTML page."""
    body = found.body
    facts = [(f"{number(body.mass)} kg", f"mass, ± {number(float(body.std[0]), 2)} kg")]
    if found.seen:
        facts += [
            (f"{number(1e3 * float(np.linalg.norm(body.centre)))} mm", f"centre of mass from {found.mount.frame}"),
            (f"{number(1e3 * float(body.std[1:4].max()), 2)} mm", "largest standard error of the centre"),
        ]
    notes = tuple(f"{words(note)}." for note in found.notes)
    drawn: list[PageBlock] = [shares_table(found)]
    if found.seen:
        drawing = figures.payload_figure(found, {source.value: name for source, name in SOURCES.items()})
        drawn.append(Figure(drawing, "Shares of the variance of each component."))
    sections = [
        PageSection("What the arm carries", (Facts(tuple(facts)), payload_words(found), payload_table(found), _WHAT)),
        PageSection("Warnings", (notes or "None.",)),
        PageSection("Where the errors come from", tuple(drawn)),
        PageSection("Torque", tuple(torque_table(found)) or ("Two results are compared: no recording is here.",)),
        PageSection("Gains of the drives", tuple(gains_table(found, always=True))),
        PageSection("Settings and versions", tuple(_settings(found, arm))),
    ]
    return render(f"Payload of {arm.model.name}", f"On {found.mount.frame}, moved by {found.mount.joint}.", sections)


def _settings(found: Payload, arm: Identification) -> Iterator[PageBlock]:
    request = found.request
    known = "" if request.known_mass is None else f"{request.known_mass:g} kg"
    gains = f"{request.gain_error:g} % uncertain" if request.gains is None else "of an earlier payload of known mass"
    yield pairs(
        "setting",
        [
            ("frame", found.mount.frame), ("known mass", known or "none"), ("gains", gains),
            ("friction may change by", f"{request.friction_change:g} %"),
            ("friction by the load", f"about {request.load_friction:g} % of it"),
            ("removed", "yes" if request.removed else "no"),
            ("standard errors made larger by", number(found.factor, 3)),
        ],
    )  # fmt: skip
    sources = arm.provenance
    if sources.configuration:
        yield pairs("configuration", [("file", sources.configuration.path)])
    yield pairs("program", list(sources.versions.items()))


@words.register
def _(note: said.NotShown) -> str:
    named = ", ".join(
        f"{MEANINGS[name]} (± {short(std, 2)} {name.unit})" for name, std in zip(note.components, note.std, strict=True)
    )
    text = f"the motion does not show {named} of the payload; "
    if not note.joint:
        return f"{text}no single joint would by itself: {_TOGETHER}"
    then = ", ".join(f"{short(std, 2)} {name.unit}" for name, std in zip(note.components, note.then, strict=True))
    return (
        f"{text}10 s of turning {note.joint} back and forth at up to {short(note.speed, 2)} {note.unit} would "
        "lower that to "
        f"± {then}; `dynident excite` designs a motion of all joints"
    )


@words.register
def _(note: said.PayloadOrDrift) -> str:
    what = f"{percent(100 * note.share, 2)} of the variance of the {MEANINGS[note.component]} is due to friction and "
    what += "offsets that may have changed since the arm was identified: the data do not tell that from the payload; "
    if note.unloaded:
        return f"{what}move the arm through more postures, each joint in both directions"
    return f"{what}record the same motion without the payload on the same day (--unloaded)"


@words.register
def _(note: said.GainsUnknown) -> str:
    return (
        f"the mass is known to ± {short(note.std, 2)} kg because the gains of the drives are taken as known to "
        f"{note.common:g} %; with known gains it would be ± {short(note.data, 2)} kg. A common error of all gains "
        "is only "
        "seen with a payload that was weighed (--known-mass, then --gains)"
    )


@words.register
def _(note: said.NoPayload) -> str:
    return f"no payload is seen: {_nothing(note.mass, note.std)}"


@words.register
def _(note: said.OtherArm) -> str:
    return (
        f"payload, drift and gains leave {short(note.factor, 2)} times what the standard errors allow, which are "
        "made larger "
        "by that: is this the arm that was identified, with the same tool, zeros and terms?"
    )


@words.register
def _(note: said.SameRecording) -> str:
    return f"{note.source}: the result was made from it, so it counts there and is left out here"
