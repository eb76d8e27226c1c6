"""`hesr check --kind hostile`: our FMUs withstand every master; failures of others are reported."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from containing import Containing
from fmu_files import changed, texts
from pythonfmu.builder import FmuBuilder

from fmu_src import export_fmu
from fmu_src.check.run import check
from fmu_src.export import package
from fmu_src.friction.friction_fmu import export_bare
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.hostile import master as hostile
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.stops.form import Structure

SLAVE = """
import os
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Slave(Fmi2Slave):
    def __init__(self, **more):
        super().__init__(**more)
        self.u, self.x, self.last, self.read = 0.0, 0.0, 0.0, 0
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0))
        self.register_variable(Real("y", causality=Fmi2Causality.output, getter=self.look))

    def look(self):
        self.read += 1
        return self.x

    def do_step(self, time, step):
        BODY
        return True
"""

LAG = "self.x += step * 20.0 * (self.u - self.x)"


@pytest.fixture
def python_fmu(tmp_path: Path) -> Callable[[str], Path]:
    def make(body: str, look: str = "return self.x") -> Path:
        (tmp_path / "slave.py").write_text(
            SLAVE.replace("BODY", body).replace("return self.x", look), encoding="utf-8"
        )
        return Path(FmuBuilder.build_FMU(tmp_path / "slave.py", dest=tmp_path / "Slave.fmu"))

    return make


def found(fmu: Path) -> list[str]:
    return texts(check(fmu, kinds=["hostile"]), "hostile")


# --- our FMUs ----------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("law", ["lugre", "viscous", "elements"])
def test_friction_laws_pass(law, make_law, make_model, tmp_path):
    model = make_model(make_law(law), make_law(law))
    report = check(export_fmu(model, tmp_path / "F.fmu"), kinds=["hostile"])
    assert report.problems == ()
    assert not any("ostile" in reason for reason in report.skipped)


@pytest.mark.ci
def test_stops_and_ripple_pass_with_signals_of_their_size(make_model, tmp_path):
    """Ripple is faster than the steps, and bounds by load jump with held inputs."""
    form = Structure.from_json(
        {"stops": [["1", 0], ["p", 0], ["load", 0]], "viscous": ["1"], "ripple": [1009, 505],
         "window": 0.015}
    ).form()  # fmt: skip
    values = {c.name: 1.0 for c in form.coefficients} | {"v_s": 0.1, "T": 0.05, "load_scale": 40.0}
    law = FrictionLaw(name="by_hand", form=form, values=values)
    seen = TrainedRange(
        dq=(-1.2, 1.2), q=(-2.6, 2.6), tau_load=(-70.0, 70.0), tau=(-5.0, 5.0), sample_time=0.01
    )
    model = make_model(law, law, trained=(seen, seen), sample_time=0.01)
    assert found(export_bare(model, tmp_path / "F.fmu")) == []


def test_the_papers_law_and_its_drive_pass(table1, table1_fmu, tmp_path):
    drive = export_drive(table1, tmp_path / "D.fmu", inertia=[3.0, 3.0, 0.6])
    assert found(table1_fmu) == []
    assert found(drive) == []


# --- faults of other FMUs ----------------------------------------------------------------------


@pytest.fixture
def reworked(make_law, make_model, tmp_path, monkeypatch) -> Callable[..., Path]:
    """An FMU of a law with modified interface code."""

    def make(law: str, old: str, new: str) -> Path:
        glue, changes = package.read_c_source, []

        def other(name: str) -> str:
            text = glue(name)
            changes.extend([name] * text.count(old))
            return text.replace(old, new)

        monkeypatch.setattr(package, "read_c_source", other)
        fmu = export_fmu(make_model(make_law(law)), tmp_path / "F.fmu")
        assert changes
        return fmu

    return make


def test_refusal_of_a_dummy_state_is_reported(reworked):
    fmu = reworked("viscous", "n != own && (own > 0 || n > 1)", "n != own")
    assert found(fmu) == [Containing("solvers that need one state add")]


@pytest.mark.ci
def test_an_additional_state_is_reported(reworked):
    fmu = reworked("lugre", "n != own && (own > 0 || n > 1)", "n < own")
    assert found(fmu) == [
        "fmi2SetContinuousStates with one state too many: it is accepted without an error."
    ]


def test_endless_events_are_reported(reworked):
    answer = "memset(info, 0, sizeof *info);"
    fmu = reworked("lugre", answer, f"{answer} info->newDiscreteStatesNeeded = fmi2True;")
    assert found(fmu) == [
        Containing(way, "fmi2NewDiscreteStates requests iterations endlessly.")
        for way in (
            "inputs held over each step",
            "inputs set after events only",
            "fmi2SetContinuousStates with one state too many",
        )
    ]


@pytest.mark.ci
def test_a_refused_last_step_is_reported(reworked):
    fmu = reworked(
        "lugre", "if (is_rounding(step)) {", "if (is_rounding(step)) {\n return fmi2Discard;"
    )
    first, second = found(fmu)
    assert first == Containing("1e-14 s at 1 s is discarded", "20 times")
    assert second.endswith("canHandleVariableCommunicationStepSize is true.")


# --- PythonFMU ---------------------------------------------------------------------------------


def test_a_lag_passes(python_fmu):
    assert found(python_fmu(LAG)) == []


def test_a_division_by_the_step_is_reported(python_fmu):
    sentences = found(python_fmu("self.x, self.last = (self.u - self.last) / step, self.u"))
    assert [s.partition(":")[0] for s in sentences] == [
        Containing("rounding size, as summed times leave"),
        "steps of rounding size between others",
    ]
    for sentence in sentences:
        match = re.search(r"'y' is (\S+) at \S+ s after a step", sentence)
        assert match
        assert abs(float(match[1])) > 1e9


@pytest.mark.ci
def test_a_false_capability_is_reported(python_fmu):
    fmu = python_fmu(f"assert abs(step - 0.01) < 1e-6, 'only 10 ms'\n        {LAG}")
    sentences = found(fmu)
    assert len(sentences) == 7
    promised = [
        s for s in sentences if s.endswith("canHandleVariableCommunicationStepSize is true.")
    ]
    assert [s.partition(":")[0] for s in promised] == list(hostile._FREE_STEP_SCENARIOS.values())
    assert "fmi2DoStep of 0.002 s at 0 s" in promised[0]


@pytest.mark.ci
def test_only_declared_step_sizes_are_used(python_fmu, tmp_path):
    def fixed(xml):
        xml.find("CoSimulation").set("canHandleVariableCommunicationStepSize", "false")

    report = check(changed(python_fmu(LAG), tmp_path / "Fixed.fmu", fixed), kinds=["hostile"])
    assert texts(report, "hostile") == []
    assert Containing("only steps of 0.01 s") in report.skipped


def test_reading_with_side_effects_is_reported(python_fmu):
    (sentence,) = found(python_fmu("self.x = self.u + self.read"))
    assert sentence.startswith("reading outputs between fmi2SetReal and fmi2DoStep: 'y' is ")


def test_a_crash_ends_only_its_own_scenario(python_fmu):
    sentences = found(python_fmu(f"step > 1e-9 or os.kill(os.getpid(), 11)\n        {LAG}"))
    assert sentences == [
        Containing(name, "signal 11 (SIGSEGV)", claim)
        for name, claim in (
            ("a last step of rounding size", ""),
            (
                "steps of rounding size between others",
                "canHandleVariableCommunicationStepSize",
            ),
        )
    ]


@pytest.mark.ci
def test_an_endless_step_is_reported(python_fmu, monkeypatch):
    monkeypatch.setattr(hostile, "SECONDS", 8.0)
    sentences = found(python_fmu(f"while step < 1e-9: pass\n        {LAG}"))
    assert sentences[0] == Containing("last step of rounding size", "within 8 s")
    assert len(sentences) == 2


def test_a_missing_binary_is_reported(source_fmu):
    report = check(source_fmu, kinds=["hostile"])
    assert report.problems == ()
    assert Containing("platform, linux64, is missing") in report.skipped
