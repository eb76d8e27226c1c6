"""Section of a page that reads a measured log and detects drift of friction."""

from typing import Any

from fmu_src.pages.html import rendered
from fmu_src.pages.live.body import PageBody
from hesr_model.friction.factors import CHANGE, CHANGE_OF_OFFSET
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.guess import vocabulary
from hesr_model.logs.log_format import LogFormat
from hesr_model.units import OTHERS, SLIDING, TURNING

_LOAD = ("load", "rigid", "gravity")
_FRICTION = ("friction", "fric")  # words in the names of columns that exist only in processed logs


def log_section(model: FrictionModel, body: PageBody | None = None, key: str = "live") -> str:
    """Return the section of a page that takes a log; with a body it computes the rigid-body torque.

    It needs a live section of the same key before it and `page.live_assets(log=True)` after it.
    """
    return rendered("log.html.j2", data=_data(model, body), key=key)


def _data(model: FrictionModel, body: PageBody | None) -> dict[str, Any]:
    # With coupled joints, ranges and errors are those of motors.
    own = model.coupling is None
    count = len(model.joints)
    trained = model.trained if own and model.trained else (None,) * count
    noise = model.training_rmse if own and model.training_rmse else (None,) * count
    used = {s.name for law in model.laws for s in law.form.inputs}
    return {
        "words": {**vocabulary(), "load": _LOAD, "friction": _FRICTION},
        "units": {"t": OTHERS["t"], **_units(model)},
        "cutoff": body.cutoff if body else LogFormat().filter_cutoff,
        "body": body.data(model.joints) if body else None,
        "change": CHANGE,
        "shift": CHANGE_OF_OFFSET,
        "joints": [
            {
                "name": name,
                "uses": sorted({s.name for s in law.form.inputs} if own else used),
                "speeds": seen.dq if seen else None,
                "noise": error,
            }
            for name, law, seen, error in zip(model.joints, model.laws, trained, noise, strict=True)
        ],
    }


def _units(model: FrictionModel) -> dict[str, dict[str, float]]:
    """Return units by quantity, SI first; only SI if joints of both kinds exist."""
    kinds = [SLIDING if slides else TURNING for slides in set(model.slides)]
    if len(kinds) == 1:
        return {quantity: dict(units) for quantity, units in kinds[0].items()}
    return {quantity: {"SI": 1.0} for quantity in TURNING}
