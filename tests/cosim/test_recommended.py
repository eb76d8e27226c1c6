"""The law of a run whose joints have different laws: its model and its FMU."""

from dataclasses import replace
from pathlib import Path

from joint_data import law

from cosim.study.run import write_mixed_model
from cosim.study.verdict import Separation, Verdict
from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.pages.datasheet import ModelAudit
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.trained_range import TrainedRange

COULOMB = {"F_c": 3.0, "F_s": 4.0, "v_s": 0.1, "sigma_2": 1.5, "tau_0": 0.0}
RANGE = TrainedRange(
    sample_time=0.01, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(0.0, 1.0), tau=(-4.0, 4.0)
)


def model(name: str, values: dict[str, float]) -> FrictionModel:
    laws = tuple(law(name, {}, **values | {"tau_0": 0.1 * k}) for k in range(2))
    return FrictionModel(
        law=name,
        robot="bench",
        joints=("a", "b"),
        laws=laws,
        sample_time=0.01,
        trained=(RANGE, replace(RANGE, dq=(-2.0, 2.0))),
    )


MODELS = {
    "stribeck": model("stribeck", COULOMB),
    "lugre": model("lugre", COULOMB | {"sigma_0": 500.0, "sigma_1": 1.0}),
}


def verdict(name: str, *laws: str) -> Verdict:
    return Verdict(
        law=name,
        fmu=f"fmus/{name}.fmu",
        test="unseen",
        why="",
        unexplained={},
        weak=(),
        improve=(),
        joints=tuple(
            Separation(best=one, tied=(), detectable=None, seconds=1.0, law=one) for one in laws
        ),
    )


def test_joints_of_different_laws_get_a_model_and_an_fmu(tmp_path: Path) -> None:
    audits = {name: ModelAudit.from_model(own, own.trained) for name, own in MODELS.items()}
    words = verdict(MIXED, "stribeck", "lugre")
    (found,) = write_mixed_model(words, MODELS, tmp_path, audits, {}).values()
    assert [one.name for one in found.laws] == ["stribeck", "lugre"]
    assert found.laws == (MODELS["stribeck"].laws[0], MODELS["lugre"].laws[1])
    assert found.trained == (MODELS["stribeck"].trained[0], MODELS["lugre"].trained[1])
    written = FrictionModel.read(tmp_path / "laws" / f"{MIXED}.json")
    assert written.laws == found.laws
    fmu = tmp_path / "fmus" / f"{MIXED}.fmu"
    carried = read_embedded_model(fmu)
    assert carried is not None
    assert carried.laws == found.laws


def test_one_law_on_all_joints_needs_no_further_fmu(tmp_path: Path) -> None:
    assert write_mixed_model(verdict("lugre", "lugre", "lugre"), MODELS, tmp_path, {}, {}) == {}
    assert list(tmp_path.iterdir()) == []
