"""The fit of every law: its coefficients and further results."""

import pytest
from joint_data import GEAR_RATIO, along, law, path
from unchanged import Unchanged

from hesr_model.audit.audit import audit
from hesr_model.audit.certificate import certify
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict

TRUTH = law(
    "lugre_load",
    {},
    sigma_0=600.0,
    sigma_1=1.0,
    sigma_2=4.0,
    F_c=8.0,
    F_s=11.0,
    v_s=0.1,
    tau_0=0.5,
    mu=0.02,
)

FLAT = ("parfam_h",)
"""Laws with poorly determined coefficients: round-off decides where their fit ends."""


def fitted(name: str) -> FrictionModel:
    records = [
        along(TRUTH, path(k, seconds=5.0), noise=0.3, seed=k, log=str(k), gear_ratio=GEAR_RATIO)
        for k in range(2)
    ]
    return fit_models([name], [records], robot="bench", seed=0, workers=1)[name]


@pytest.mark.parametrize("name", registry())
def test_fits_are_unchanged(name: str, unchanged: Unchanged) -> None:
    model = fitted(name)
    own, trained = model.laws[0], model.trained[0]
    way = path(9, seconds=5.0)
    predicted = predict(own, t=way.t, dq=way.dq, q=way.q, tau_load=way.load)
    found = {"predicted": predicted, "rmse": model.training_rmse}
    if name in FLAT:
        unchanged(found, rtol=0.02)
        return
    found |= {
        "trained": trained,
        "values": own.values,
        "band": own.band,
        "standard errors": own.standard_errors,
        "audit": audit(own, trained),
        "certificate": certify(own, trained),
    }
    unchanged(found, rtol=1e-3, atol=1e-6)
