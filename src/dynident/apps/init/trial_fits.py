"""What a draft takes from the values of its logs: gains of currents, and the direction of gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from dynident.apps.init.column_mapping import ChannelProposal, ColumnMapping
from dynident.apps.init.config_draft import LogSource, draft_config
from dynident.apps.init.match import MovableJoint
from dynident.checks import relative_gains
from dynident.estimators import PhysicallyConsistent
from dynident.files.xml_text import SUFFIXES
from dynident.identification import cut_excerpts, find_mounting, has_gravity, tilt_base, with_plain_terms
from dynident.models import Model
from dynident.motion.log import Motion, thin_motions
from dynident.motion.smoothers import Spline, smooth_log
from dynident.project.columns import COMMANDED, families
from dynident.project.project import parse_project
from dynident.runtime import DynidentError
from dynident.runtime.arrays import Array

SMOOTHER = Spline(factor=8.0)  # position noise may not be white, and the slow torque of gravity tells most
MOUNTING_SAMPLES = 2000  # of all logs together, for the fits that compare directions of gravity
GRAVITY_DECIMALS = 6
MAX_UNPROPORTIONAL = 0.1  # of the rms of a commanded torque: what the commanded current may leave of it
MIN_FOLLOWING = 0.5  # of a commanded current, or its inverse: what the measured one is of it, where units agree
_GAIN_QUESTION = (
    "the gains are those with which gravity and inertia of the robot file explain the motion: are its masses right? "
    "Errors in % do not depend on a factor that all gains share, but masses, inertias and friction do; data sheets or "
    "a known payload tell it"
)
_COMMANDED_QUESTION = "the gains are {!r} over {!r}, as the controller commands them: are its motor constants right?"
_HIDDEN_GAIN = "gravity and inertia of the robot file explain too little of the column to estimate it"


class DraftFits:
    """The fits to the logs of a draft; the arguments are those of ``draft_config``."""

    def __init__(self, robot: str, joints: Sequence[MovableJoint], sources: Sequence[LogSource], folder: Path) -> None:
        self.robot, self.joints, self.sources, self.folder = robot, joints, sources, folder

    def read(self, mapping: ColumnMapping) -> tuple[Model, list[Motion]]:
        """Return the model and the smoothed training logs of a mapping; DynidentError where they cannot be read."""
        text = draft_config(self.robot, self.joints, mapping, self.sources, self.folder).text
        project = parse_project(text, self.folder / "draft.yaml")
        names = tuple(joint.name for joint in project.model.joints)
        logs = [log.select(names) for log in project.logs()[0]["train"].values()]
        return project.model, [smooth_log(SMOOTHER, log) for log in cut_excerpts(logs)]

    def with_gains(self, mapping: ColumnMapping) -> ColumnMapping:
        """Return the mapping with a proposed ``factor`` for each current whose gain the motion shows.

        It is unchanged where no gain is needed, or where the logs cannot be read yet, for example because the time is
        not known.
        """
        if not any(channel.gain for channel in mapping.torque.values()):
            return mapping
        if torque := self._commanded_gains(mapping):
            return replace(mapping, torque=torque)
        # a draft without gains is complete, so that the logs can be read in the units of the currents
        torque = {name: replace(channel, gain="") for name, channel in mapping.torque.items()}
        try:
            gains = relative_gains(*self.read(replace(mapping, torque=torque)))
        except DynidentError:  # whatever it is, it is said where the configuration is read
            return mapping
        torque = {
            name: _propose_gain(
                channel, gains[name].value, _GAIN_QUESTION,
                f"{gains[name].value:.4g} +- {gains[name].std:.2g} from the robot file: {channel.gain}?",
            )
            if name in gains
            else replace(channel, gain=channel.gain and f"{channel.gain} ({_HIDDEN_GAIN})")
            for name, channel in mapping.torque.items()
        }  # fmt: skip
        return replace(mapping, torque=torque)

    def _commanded_gains(self, mapping: ColumnMapping) -> dict[str, ChannelProposal]:
        """Return the torque channels with the gains that a controller has between the torques and currents it commands.

        Robots of Universal Robots log both. Empty where not all joints have such a pair of columns.
        """
        columns = self.sources[0].table.columns
        log_families = families(columns, [joint.name for joint in self.joints])
        keys = {column: key for family in log_families for key, column in family.columns.items()}
        torques, currents = (
            [family.columns for family in log_families if (family.role, family.rank) == (role, COMMANDED)]
            for role in ("torque", "current")
        )
        for torque, current in product(torques, currents):
            question = _COMMANDED_QUESTION.format(next(iter(torque.values())), next(iter(current.values())))
            proposals: dict[str, ChannelProposal] = {}
            for name, channel in mapping.torque.items():
                key = keys.get(channel.column or "")
                if channel.column and key in torque and key in current:
                    gain = _commanded_gain(columns[channel.column], columns[torque[key]], columns[current[key]])
                    proposals |= {name: _propose_gain(channel, gain, question)} if gain else {}
            if len(proposals) == len(mapping.torque):
                return proposals
        return {}

    def with_gravity(self, mapping: ColumnMapping) -> ColumnMapping:
        """Return the mapping with the ``gravity`` of a robot on a wall or ceiling, where torques in N m decide it."""
        channels = mapping.torque.values()
        if Path(self.robot).suffix.lower() not in SUFFIXES or not channels or any(x.gain for x in channels):
            return mapping
        try:
            model, motions = self.read(mapping)
            if not has_gravity(model):
                return mapping
            plain, thin = with_plain_terms(model), thin_motions(motions, MOUNTING_SAMPLES)
            mounting = find_mounting(plain, [plain.remembering(motion) for motion in thin], PhysicallyConsistent())
        except DynidentError:  # as above
            return mapping
        if mounting is None:
            return mapping
        mounted = tilt_base(model, *mounting)
        gravity = next(term.gravity for term in mounted.terms if term.gravity and any(term.gravity))
        x, y, z = (round(g, GRAVITY_DECIMALS) + 0.0 for g in gravity)  # a right angle leaves 1e-15
        return replace(mapping, gravity=(x, y, z))


def _propose_gain(channel: ChannelProposal, gain: float, *questions: str) -> ChannelProposal:
    return replace(channel, factor=gain, questions=(*channel.questions, *questions))


def _commanded_gain(measured: Array, torque: Array, current: Array) -> float:
    """Return the ratio of a commanded torque to its current, 0 where it is no constant.

    The measured current, which the gain is for, has to follow the commanded one in the same unit.
    """
    if not len(measured) == len(torque) == len(current):
        return 0.0
    rows = np.column_stack([measured, torque, current])
    measured, torque, current = rows[np.isfinite(rows).all(axis=1)].T
    power = float(current @ current)
    if not MIN_FOLLOWING * power < measured @ current < power / MIN_FOLLOWING:
        return 0.0
    gain = float(torque @ current) / power
    residual = torque - gain * current
    return gain if residual @ residual < MAX_UNPROPORTIONAL**2 * (torque @ torque) else 0.0
