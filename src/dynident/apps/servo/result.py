"""An identified arm of servos: the values that were found, and what its model is good for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from dynident.apps.servo.backlash import Backlash
from dynident.apps.servo.fit import ServoFit
from dynident.apps.servo.judge import ServoRollout, ServoUse, verdict_of
from dynident.apps.servo.values import FRICTION, Entry, Quantity, ServoValues
from dynident.identification import SourceFile
from dynident.models import Joint
from dynident.motion.splines import NORMAL_95
from dynident.runtime import Noun

if TYPE_CHECKING:
    import polars as pl

NOT_JUDGED = "not judged: no recording is held out"
UNITS = {  # of joints that turn, and of those that slide
    Quantity.ARMATURE: ("kg m^2", "kg"), Quantity.DAMPING: ("N m s/rad", "N s/m"), Quantity.FRICTIONLOSS: ("N m", "N"),
    Quantity.KP: ("N m/rad", "N/m"), Quantity.OFFSET: ("rad", "m"), Quantity.COMMAND_OFFSET: ("rad", "m"),
    Quantity.MASS: ("", ""), Quantity.DELAY: ("s", "s"),
}  # fmt: skip


class ServoIdentification(Noun):
    """The identified model of a servo arm: the ``fit``, the values of the ``nominal`` file, and what they are worth.

    ``suspects`` were given, but contradict the log, and are fitted too; ``backlash`` are the gaps found, which the
    model lacks. ``mjcf`` is the robot file with the fitted values, whose rollout is ``difference`` (rad, m) from that
    of the fit. ``hashes`` are the SHA-256 of all files read; commands are ``held``, else interpolated.
    """

    name: str
    joints: tuple[Joint, ...]
    fit: ServoFit
    nominal: ServoValues
    suspects: tuple[Entry, ...]
    backlash: tuple[Backlash, ...]
    rollouts: tuple[ServoRollout, ...]
    mjcf: str
    difference: float
    warnings: tuple[str, ...]
    hashes: dict[str, str]
    configuration: SourceFile | None
    held: bool

    def __repr__(self) -> str:
        return f"<ServoIdentification of {self.name!r}: {self.use or NOT_JUDGED}, {len(self.fit.entries)} values>"

    @property
    def use(self) -> ServoUse | None:
        """What the model is good for, by held-out rollouts; None where there is none. With backlash, which is not in
        the model, at best with care."""
        use = verdict_of(self.rollouts)
        return ServoUse.CARE if self.backlash and use is ServoUse.GOOD else use

    def rows(self) -> Iterator[tuple[Entry, float, float, float | None]]:
        """Yield each entry of the fit, joint by joint, with value, standard error and the value of the file."""
        fit = self.fit
        stds = dict(zip(fit.entries, fit.std, strict=True))
        order = list(Quantity)
        for entry in sorted(fit.entries, key=lambda e: (e.quantity is Quantity.DELAY, e.k, order.index(e.quantity))):
            value, nominal = fit.values.entry(entry), self.nominal.entry(entry)
            # of a delay, and of a kp that equals what was found, the file says nothing
            is_said = entry.quantity is not Quantity.DELAY and nominal != value
            yield entry, value, float(stds[entry]), nominal if is_said else None

    def unit(self, entry: Entry) -> str:
        """Return the unit of an entry, "" for a factor."""
        return entry_unit(entry, self.joints, self.fit.values)

    def parameters(self) -> list[dict[str, Any]]:
        """Return the fitted values as rows: joint, quantity, value, standard error ``std``, and the value of the file.

        ``low`` and ``high`` hold 95 %, as for domain randomisation; ``given`` are those that contradict the file.
        """
        return [
            {
                "joint": None if entry.quantity is Quantity.DELAY else self.joints[entry.k].name,
                "quantity": str(entry.quantity), "value": value, "std": std, "file": nominal,
                "unit": self.unit(entry),
                "low": max(value - NORMAL_95 * std, 0.0) if entry.quantity in FRICTION else value - NORMAL_95 * std,
                "high": value + NORMAL_95 * std, "given": entry in self.suspects,
            }
            for entry, value, std, nominal in self.rows()
        ]  # fmt: skip

    def frame(self) -> pl.DataFrame:
        """Return ``parameters`` as a table."""
        import polars as pl

        return pl.DataFrame(self.parameters())


def entry_name(entry: Entry, joints: Sequence[str]) -> str:
    """Return the name of a parameter, such as ``armature of elbow``."""
    words = str(entry.quantity).replace("_", " ")
    return words if entry.quantity is Quantity.DELAY else f"{words} of {joints[entry.k]}"


def entry_unit(entry: Entry, joints: Sequence[Joint], values: ServoValues) -> str:
    """Return the unit of a parameter, "" for a factor; that of an offset of a commanded torque is a torque's."""
    is_torque = entry.quantity is Quantity.COMMAND_OFFSET and values.takes_torque[entry.k]
    return UNITS[Quantity.FRICTIONLOSS if is_torque else entry.quantity][joints[entry.k].kind == "prismatic"]
