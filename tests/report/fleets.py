"""A made fleet for its report: values, changes and scatter as they are, without a fit."""

from datetime import datetime, timedelta

import numpy as np
import polars as pl

from dynident.apps.fleets import Change, Changes, ChangeShape, FleetBase, FleetResult, History, Scatter, pool_robots
from dynident.apps.fleets.fit import schema
from dynident.models import Joint
from dynident.regression import GroupKind, ParameterGroup
from dynident.runtime.jobs import Status

START = datetime(2026, 1, 5, 8)
MEAN = np.array([12.0, 8.0, 9.0, 6.0, 0.1, -0.2, 0.3, 0.02, 0.1])
STD = 0.01 * np.abs(MEAN) + 0.003
UNITS = ("N m s/rad", "N m", "N m s/rad", "N m", "N m", "N m", "kg m", "kg m", "kg m")
SIZE = len(MEAN)
PAYLOAD = np.zeros((SIZE, 4))
PAYLOAD[6:9, 1:] = np.eye(3)
PAYLOAD[6:9, 0] = 0.5, 0.0, 0.2
PAYLOAD = PAYLOAD[:, [0, 2, 3]]  # the first direction is no base parameter alone
NONE = Scatter(tuple(np.arange(SIZE)[:, None]), np.zeros((SIZE, SIZE)), dof=100.0)
RESIDUAL = Scatter(tuple(np.arange(2)[:, None]), np.zeros((2, 2)), dof=100.0)


def names(odd: str = "") -> tuple[str, ...]:
    return tuple(
        f"{x}{odd}" for x in ("Fv_shoulder", "Fc_shoulder", "Fv_elbow", "Fc_elbow", "offset_shoulder", "offset_elbow")
    ) + tuple(f"hand{odd}.{x}" for x in ("mx", "my", "mz"))


def groups(odd: str = "") -> tuple[ParameterGroup, ...]:
    """Friction and offset of two joints, and the payload."""
    unit, all_names, joints = np.eye(SIZE), names(odd), (f"shoulder{odd}", f"elbow{odd}")
    result = [
        ParameterGroup(GroupKind.FRICTION, joint, unit[:, 2 * j : 2 * j + 2], all_names[2 * j : 2 * j + 2], UNITS[:2])
        for j, joint in enumerate(joints)
    ]
    parts = tuple(f"hand{odd}.{x}" for x in ("mass", "my", "mz"))
    result.append(ParameterGroup(GroupKind.PAYLOAD, joints[1], PAYLOAD, parts, ("kg", "kg m", "kg m")))
    result += [
        ParameterGroup(GroupKind.OFFSET, joint, unit[:, 4 + j : 5 + j], all_names[4 + j : 5 + j], ("N m",))
        for j, joint in enumerate(joints)
    ]
    return tuple(result)


def history(robot: str, logs: int = 20, seed: int = 0, noise: float = 1.0) -> History:
    rng = np.random.default_rng(seed)
    days = np.sort(rng.uniform(0, 300, logs))
    value = MEAN + noise * STD * rng.standard_normal((logs, SIZE))
    files = tuple(f"logs/{robot}/{k:04}.parquet" for k in range(logs))
    return History(robot, files, days, value, np.tile(np.diag(STD**-2), (logs, 1, 1)))


def change(
    case: History, group: ParameterGroup, shape: ChangeShape, index: int, size: list[float], **more: object
) -> Change:
    given = {"std": np.full(len(size), 0.05), "odds": 50.0, "p_value": 0.001} | more
    rate = np.array(size) / (case.days[-1] - case.days[index]) if shape is ChangeShape.DRIFT else None
    since, day, between = case.logs[index], float(case.days[index]), (case.logs[index - 1], case.logs[index])
    return Change(case.robot, group, shape, index, since, day, np.array(size), per_day=rate, between=between, **given)


def row(robot: str, log: str, day: float, k: int, **more: object) -> dict[str, object]:
    usual = {
        "robot": robot, "type": "ur10", "log": log, "date": START + timedelta(days=day), "recipe": "ab12", "stamp": "x",
        "status": Status.OK.value, "reason": "", "seconds": 3.0, "version": "0.9", "samples": 5000,
        "verdict": "good for control", "error": 4.1, "errors": [3.0, 5.0], "held_out": None, "value": None,
        "information": None, "folder": f"runs/{robot}/{k}",
    }  # fmt: skip
    return usual | more


def fleet(robots: int = 10, logs: int = 20, odd: str = "", changed: int = 3) -> FleetResult:
    """Robots of one type; on the first ``changed`` a payload, friction and an offset change. One log has failed."""
    histories = [history(f"arm-{r}{odd}", logs, r) for r in range(robots)]
    kinds, half = groups(odd), logs // 2
    result = [
        change(histories[0], kinds[2], ChangeShape.STEP, half, [0.5, 0.0, 0.3]),
        change(histories[min(1, robots - 1)], kinds[1], ChangeShape.DRIFT, half, [0.0, 1.5], p_value=0.004),
        change(histories[min(2, robots - 1)], kinds[4], ChangeShape.STEP, half, [-0.4], p_value=0.008, odds=1.5),
    ][:changed]
    rows = [
        row(x.robot, log, day, k, type=f"ur10{odd}")
        for x in histories
        for k, (log, day) in enumerate(zip(x.logs, x.days, strict=True))
    ]
    lost = {"status": Status.TIMED_OUT.value, "reason": f"longer than 5 s{odd}.", "verdict": None, "folder": ""}
    rows.append(row(histories[-1].robot, f"logs/late{odd}.parquet", 300.0, logs, error=None, errors=None, **lost))
    kind = f"ur10{odd}"
    return FleetResult(
        name=f"cell{odd}",
        rows=pl.DataFrame(rows, schema=schema()),
        base=FleetBase(names(odd), UNITS, names(odd), (Joint(f"shoulder{odd}"), Joint(f"elbow{odd}"))),
        histories=tuple(histories),
        groups=kinds,
        types={kind: tuple(x.robot for x in histories)},
        start=START,
        identified_count=7,
        warnings=(f"the column 'note{odd}' is not used",),
        changes=(Changes(0.01, tuple(result), {x.robot: 0.5 for x in histories}, (f"new{odd}",), NONE),),
        pooled={kind: pool_robots(histories[:20], kinds, NONE)} if robots > 2 else {},
    )
