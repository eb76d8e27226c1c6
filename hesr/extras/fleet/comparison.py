"""Comparison of robots: deviations from their type, and changes."""

from collections.abc import Iterator, Sequence

from hesr.extras.adaptive.monitor import POINTS_TO, shared_signs
from hesr.extras.fleet.result import BODY, Change, Deviant, JointResult, RobotResult
from hesr_model.fitting.uncertainty import MOST_COEFFICIENTS
from hesr_model.inference.comparison import holm
from hesr_model.inference.deviation import ENOUGH, Deviation, deviations

Key = tuple[str, str, str, str]  # robot, law, joint, and name of a number
_KINDS = {"level": "drift", "offset": "shift", "error": "error"}
_POINTS_TO = POINTS_TO | {"error": "play, damage, or a sensor: no friction law explains it"}
_ERROR = "rmse"


def compared(
    robots: Sequence[RobotResult], level: float
) -> tuple[dict[tuple[str, str, str], dict[str, float]], list[Deviant]]:
    """Compare numbers of a type and law structure with at least `ENOUGH` robots.

    Returns z by (robot, law, joint), then by name, and deviants at significance `level` (Holm).
    """
    groups: dict[tuple[str, ...], list[tuple[RobotResult, float, float | None]]] = {}
    for robot in robots:
        for one in robot.joints:
            for name, value in _numbers(one):
                group = (robot.type, one.law, one.joint, one.structure, name)
                groups.setdefault(group, []).append((robot, value, one.errors.get(name)))
    found: dict[Key, tuple[str, Deviation]] = {}
    for (type_, law, joint, _, name), of in groups.items():
        if len(of) >= ENOUGH:
            each = deviations([value for _, value, _ in of], [error for *_, error in of])
            for (robot, *_), apart in zip(of, each, strict=True):
                found[robot.robot, law, joint, name] = type_, apart
    p = holm({key: apart.p for key, (_, apart) in found.items()})
    deviants = []
    z: dict[tuple[str, str, str], dict[str, float]] = {}
    for (name, law, joint, what), (type_, apart) in found.items():
        z.setdefault((name, law, joint), {})[what] = apart.z
        numbers = vars(apart) | {"p": p[name, law, joint, what]}
        if numbers["p"] < level:
            deviants.append(
                Deviant(robot=name, type=type_, law=law, joint=joint, name=what, **numbers)
            )
    return z, sorted(deviants, key=lambda d: (-abs(d.z), d.robot, d.law, d.joint, d.name))


def _numbers(one: JointResult) -> Iterator[tuple[str, float]]:
    if len(one.values) <= MOST_COEFFICIENTS or one.law == BODY:  # except coefficients of networks
        yield from one.values.items()
    if one.law != BODY:
        yield _ERROR, one.rmse


def changed(robots: Sequence[RobotResult], level: float, least: float) -> list[Change]:
    """Return changes of at least the share `least` of friction at significance `level` (Holm)."""
    trends = {
        (robot.robot, one.law, one.joint, name): (robot, found)
        for robot in robots
        for one in robot.joints
        for name, found in one.trends.items()
    }
    p = holm({key: found.p for key, (_, found) in trends.items()})
    counting = {
        key: (robot, found)
        for key, (robot, found) in trends.items()
        if p[key] < level and abs(found.change) >= least
    }
    drifts: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for (name, law, joint, what), (_, found) in counting.items():
        if what == "level":
            drifts.setdefault((name, law), []).append((joint, _sign(found.change)))
    changes = []
    for key, (robot, found) in counting.items():
        name, law, joint, what = key
        kind, joints = _KINDS[what], sum(one.law == law for one in robot.joints)
        if kind == "drift" and _sign(found.change) in shared_signs(drifts[name, law], joints):
            kind = "shared drift"
        changes.append(
            Change(
                robot=name,
                type=robot.type,
                law=law,
                joint=joint,
                kind=kind,
                change=found.change,
                per_day=found.slope,
                p=p[key],
                worse=what == "offset" or found.change > 0.0,
                points_to=_POINTS_TO[kind],
            )
        )
    return sorted(
        changes, key=lambda c: (not c.worse, -abs(c.change), c.robot, c.law, c.joint, c.kind)
    )


def _sign(number: float) -> int:
    return 1 if number > 0.0 else -1
