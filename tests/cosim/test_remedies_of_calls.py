"""Remedies that calls and files of studies print are executed: the statements go away."""

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy
from hobby_servo import draw_hobby_servo
from printed_lines import write_line
from pydantic import ValidationError
from remedy_places import Place, read_quoted, refuse
from rotor import signals
from small_study import write_study

import hesr
from cosim.loop.loops import assemble
from cosim.loop.run import write_loops
from cosim.loop.traces import TRACES, copy_loops, read_traces
from cosim.report.results import Results
from cosim.study.public_logs import _find_model
from cosim.study.study import Study
from fmu_src.arm.plant import Plant
from fmu_src.plant.plant_fmu import PlantBody
from hesr.extras.studies.seeds import run_seeds
from hesr.extras.sweep.study import SweepStudy
from hesr.extras.view.stage import ViewOptions, choose
from hesr_model.fitting.law_check import require_usable_space
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot

FORCE = Coefficient(name="force", unit="N.m", description="friction")
WIDTH = Coefficient(name="width", unit="rad/s", description="width of the step")


def name_of_robot(place: Place) -> Iterator[str]:
    """A log in memory: its robot is an argument."""
    log = replace(place.arm_log, robot=None)
    yield (sentence := refuse(lambda: hesr.identify(log)))
    (name,) = read_quoted(sentence, "give")
    yield refuse(lambda: hesr.identify(log, **{name: place.arm}))


def robots_of_logs(place: Place) -> Iterator[str]:
    """A log without its robot: a body separates its friction with the robot as an argument."""
    log = Log.read(place.bench / "run.csv", place.bench / "robot.toml")
    body = hesr.RigidBody.read(place.bench / "body.json")
    unnamed_log = replace(log, robot=None)
    yield (sentence := refuse(lambda: body.separate_friction(unnamed_log)))
    (name,) = read_quoted(sentence, "give")
    assert read_quoted(refuse(lambda: body.plot(unnamed_log)), "give") == [name]
    assert not refuse(lambda: body.plot(unnamed_log, **{name: log.robot}))
    yield refuse(lambda: body.separate_friction(unnamed_log, **{name: log.robot}))


def robot_of_a_path(place: Place) -> Iterator[str]:
    law = hesr.FrictionModel.read(place.bench / "law.json")
    path = place.bench / "run.csv"
    body = place.bench / "body.json"
    yield (sentence := refuse(lambda: law.predict(path, rigid_body=body)))
    (name,) = read_quoted(sentence, "give")
    robot = {name: place.bench / "robot.toml"}
    yield refuse(lambda: law.predict(path, rigid_body=body, **robot))


def body_of_a_law(place: Place) -> Iterator[str]:
    law = replace(hesr.FrictionModel.read(place.bench / "law.json"), rigid_body=None)
    log = Log.read(place.bench / "run.csv", place.bench / "robot.toml")
    yield (sentence := refuse(lambda: law.predict(log)))
    name, command = re.findall(r"give '(\w+)', the result of 'hesr (\w+)'", sentence)[0]
    body = getattr(hesr, command)(log)
    yield refuse(lambda: law.predict(log, **{name: body}))


def arrays_of_a_prediction(place: Place) -> Iterator[str]:
    law = hesr.FrictionModel.read(place.bench / "law.json")
    yield (sentence := refuse(law.predict))
    arrays = {name: np.linspace(0.1, 1.0, 10) for name in read_quoted(sentence, "arrays")}
    yield refuse(lambda: law.predict(**arrays))


def band_of_a_law(place: Place) -> Iterator[str]:
    law = hesr.FrictionModel.read(place.bench / "bare.json")
    robot = place.bench / "robot.toml"
    log = Log.read(place.bench / "run.csv", robot)
    records = hesr.RigidBody.read(place.bench / "body.json").separate_friction(log)
    yield (sentence := refuse(lambda: law.predict_band(records)))
    (command,) = re.findall(r"'hesr (\w+)'", sentence)
    fitted_law = getattr(hesr, command)(log, law=law.law, robot=robot)
    yield refuse(lambda: fitted_law.predict_band(records))


def covariance_of_a_prior(place: Place) -> Iterator[str]:
    def adapt(law: Path) -> Any:
        return hesr.fit(place.bench / "run.csv", prior=law, robot=place.bench / "robot.toml")

    prior = hesr.FrictionModel.read(place.bench / "law.json")
    bare_laws = tuple(replace(law, covariance=None) for law in prior.laws)
    replace(prior, laws=bare_laws).write(place.folder / "prior.json")
    yield (sentence := refuse(lambda: adapt(place.folder / "prior.json")))
    assert re.findall(r"'hesr (\w+)'", sentence) == ["fit"]
    yield refuse(lambda: adapt(place.bench / "law.json"))


def body_of_a_plant(place: Place) -> Iterator[str]:
    """Masses that no body has: the refusal prints the line of the study, or the argument."""
    body = hesr.identify(place.arm_log, robot=place.arm)
    empty_body = replace(body, parameters=0.0 * body.parameters)
    yield (sentence := refuse(lambda: PlantBody.from_robot(place.arm, empty_body)))
    ((key, value),) = re.findall(r"(body) = \"(\w+)\"", sentence)
    physical_body = hesr.identify(place.arm_log, robot=place.arm, **{key: value})
    yield refuse(lambda: PlantBody.from_robot(place.arm, physical_body))


def body_of_a_study(place: Place) -> Iterator[str]:
    """A study whose body has no plant: the advice prints a line of the study."""
    body = hesr.RigidBody.read(place.results / "rigid_body.json")
    study = Study.read(place.results.parent / "study.toml")
    robot = Robot(place.results_robot)
    law = {"parfam_h": place.results / "fmus" / "parfam_h.fmu"}
    plant = Plant.read(place.results_robot.with_name("plant.toml"))
    loop = assemble(
        place.results / "fmus", robot, tracking=study.tracking, friction=law, plant=plant
    )
    models = {"parfam_h": hesr.FrictionModel.read(place.results / "laws" / "parfam_h.json")}

    def write(parameters: np.ndarray) -> str:
        changed = replace(body, parameters=parameters)
        findings = write_loops(loop, robot, changed, models, place.folder)
        return " ".join(finding.sentence for finding in findings)

    yield (sentence := write(0.0 * body.parameters))
    ((key, value),) = re.findall(r"set (\w+) = \"(\w+)\" in the study", sentence)
    text = write_study(place.folder).read_text(encoding="utf-8")
    (place.folder / "study.toml").write_text(write_line(text, "", key, f"'{value}'"), "utf-8")
    assert Study.read(place.folder / "study.toml").body == "physical"
    yield write(robot.nominal_parameters)


def unit_of_a_coefficient(_: Place) -> Iterator[str]:
    yield (sentence := refuse(lambda: Coefficient(name="width", description="width")))
    (key,) = read_quoted(sentence, "has no")
    printed_units = re.findall(r"'([\w./]+)'", sentence.partition("such as")[2])
    assert len(printed_units) == 3
    for unit in printed_units:
        assert not refuse(lambda u=unit: Coefficient(name="w", description="w", **{key: u}))
    yield ""


def coefficient_of_a_law(_: Place) -> Iterator[str]:
    output = FORCE.symbol * sympy.tanh(DQ / WIDTH.symbol)
    yield (sentence := refuse(lambda: LawForm(coefficients=(FORCE,), memory=(), output=output)))
    (key,) = read_quoted(sentence, "add it to")
    coefficients = {key: (FORCE, WIDTH)}
    yield refuse(lambda: LawForm(memory=(), output=output, **coefficients))


def symbol_of_a_law(_: Place) -> Iterator[str]:
    def form(width: sympy.Symbol, speed: sympy.Symbol) -> LawForm:
        output = FORCE.symbol * sympy.tanh(speed / width)
        return LawForm(coefficients=(FORCE, WIDTH), memory=(), output=output)

    stranger = sympy.Symbol("width")
    yield (sentence := refuse(lambda: form(stranger, DQ)))
    attribute, _ = read_quoted(sentence, "use the")
    yield refuse(lambda: form(getattr(WIDTH, attribute), DQ))


def space_of_a_law(_: Place) -> Iterator[str]:
    output = FORCE.symbol * sympy.tanh(DQ / WIDTH.symbol)
    form = LawForm(coefficients=(FORCE, WIDTH), memory=(), output=output)

    def check(**keys: Any) -> str:
        space = SearchSpace(**({"bounds": (), "linear": ("force",)} | keys))
        return refuse(lambda: require_usable_space("own", form, space))

    yield (sentence := check())
    keys = read_quoted(sentence, "add it to")
    assert keys == ["bounds", "linear", "values"]
    assert not check(bounds=(("width", (1e-3, 1.0)),))
    assert not check(values=(("width", sympy.Float(0.1)),))
    # The width is within tanh, so that it cannot be solved for; the sentence is another one.
    yield check(bounds=(("width", (1e-3, 1.0)),)) + (check(linear=("force", "width"))[:0])


SWEEP = {"system": "loop.toml", "outputs": [{"name": "end", "signal": "b.y"}], "runs": 8}
SPEED = {"variables": ["a.u"], "low": 1.0, "high": 2.0}
CORRELATED = {"variables": ["a.u"], "mean": [1.0], "covariance": [[1.0]]}


def sweep(**changes: Any) -> str:
    keys = {key: value for key, value in (SWEEP | changes).items() if value is not None}
    try:
        SweepStudy.model_validate(keys, context={"folder": Path()})
    except ValidationError as error:
        return str(error.errors()[0]["msg"])
    return ""


def inputs_of_a_sweep(_: Place) -> Iterator[str]:
    yield (sentence := sweep())
    values = {"inputs": [SPEED], "correlated": [CORRELATED]}
    for key in read_quoted(sentence, "give"):
        assert not sweep(**{key: values[key]})
    yield ""


def runs_of_a_grid(_: Place) -> Iterator[str]:
    yield (sentence := sweep(design="grid", inputs=[SPEED]))
    (key,) = read_quoted(sentence, "remove")
    yield sweep(design="grid", inputs=[SPEED], **{key: None})


def runs_of_a_design(_: Place) -> Iterator[str]:
    yield (sentence := sweep(inputs=[SPEED], runs=None))
    (key,) = read_quoted(sentence, "needs the key")
    yield sweep(inputs=[SPEED], **{key: 8})


def power_of_two(_: Place) -> Iterator[str]:
    yield (sentence := sweep(design="sobol", inputs=[SPEED], runs=12))
    (key,) = read_quoted(sentence, "needs a power of 2 as")
    yield sweep(design="sobol", inputs=[SPEED], **{key: 16})


def range_of_a_grid(_: Place) -> Iterator[str]:
    normal = {"variables": ["a.u"], "mean": 1.0, "std": 0.1}
    yield (sentence := sweep(design="grid", inputs=[normal], runs=None))
    values = {"values": [1.0, 2.0], "low": 1.0, "high": 2.0}
    first, *pair = read_quoted(sentence, "needs")
    for keys in ([first], pair):
        changed = {"variables": ["a.u"]} | {key: values[key] for key in keys}
        assert not sweep(design="grid", inputs=[changed], runs=None)
    yield ""


def distribution_of_an_input(_: Place) -> Iterator[str]:
    yield (sentence := sweep(inputs=[{"variables": ["a.u"]}]))
    values = {"values": [1.0, 2.0], "low": 1.0, "high": 2.0, "mean": 1.0, "std": 0.1}
    first, *others = read_quoted(sentence, "needs one of")
    for keys in ([first], others[:2], others[2:]):
        changed = {"variables": ["a.u"]} | {key: values[key] for key in keys}
        assert not sweep(inputs=[changed])
    yield ""


def results_to_read(place: Place) -> Iterator[str]:
    yield (sentence := refuse(lambda: Results.read(place.folder)))
    assert "hesr run" in sentence
    yield refuse(lambda: Results.read(place.results))


def results_to_view(place: Place) -> Iterator[str]:
    yield (sentence := refuse(lambda: choose(place.folder / "none", ViewOptions())))
    assert "hesr run" in sentence
    yield refuse(lambda: choose(place.results, ViewOptions()))


def arm_to_view(place: Place) -> Iterator[str]:
    for name in (TRACES, "rigid_body.json"):
        shutil.copy(place.results / name, place.folder)
    yield (sentence := refuse(lambda: choose(place.folder, ViewOptions())))
    assert "hesr run" in sentence
    yield refuse(lambda: choose(place.results, ViewOptions()))


def traces_to_view(place: Place) -> Iterator[str]:
    """A study without [tracking] has no traces; that of the results has the table."""
    yield (sentence := refuse(lambda: read_traces(place.folder / TRACES)))
    (table,) = re.findall(r"\[(\w+)\]", sentence)
    assert f"\n[{table}]\n" in read_study(place)
    yield refuse(lambda: read_traces(place.results / TRACES))


def loop_to_copy(place: Place) -> Iterator[str]:
    yield (sentence := refuse(lambda: copy_loops(place.folder, place.folder / "loop")))
    for table in re.findall(r"\[(\w+)\]", sentence.partition("'hesr run'")[2]):
        assert f"\n[{table}]\n" in read_study(place)
    yield refuse(lambda: copy_loops(place.results, place.folder / "loop"))


def read_study(place: Place) -> str:
    return (place.results.parent / "study.toml").read_text(encoding="utf-8")


def plant_of_a_study(place: Place) -> Iterator[str]:
    """A study of the twin without its signals, which the refusal names."""
    study = write_study(place.folder)
    text = study.read_text(encoding="utf-8")
    study.write_text(write_line(text, "twin", "truth", "'strain_wave'"), encoding="utf-8")
    yield (sentence := refuse(lambda: Study.read(study)))
    (key,) = read_quoted(sentence, "need the key")
    signals_file = (place.bench / "arm.toml").as_posix()
    changed = write_line(study.read_text(encoding="utf-8"), "twin", key, f"'{signals_file}'")
    study.write_text(changed, encoding="utf-8")
    yield refuse(lambda: Study.read(study))


def tracking_of_a_study(place: Place) -> Iterator[str]:
    text = read_study(place).replace("motions.toml", str(place.results.parent / "motions.toml"))
    lines = re.findall(r"(?m)^signals = .*$", text)
    study = place.folder / "study.toml"
    study.write_text(text.replace(lines[0], ""), encoding="utf-8")
    yield (sentence := refuse(lambda: Study.read(study)))
    _, key = read_quoted(sentence, "needs the keys")
    table, _, name = key.partition(".")
    value = lines[0].partition(" = ")[2]
    changed = write_line(study.read_text(encoding="utf-8"), table, name, value.replace('"', "'"))
    study.write_text(changed, encoding="utf-8")
    yield refuse(lambda: Study.read(study))


def logs_of_seeds(place: Place) -> Iterator[str]:
    study = write_study(place.folder)
    text, _, tests = study.read_text(encoding="utf-8").partition("[logs.test]")
    study.write_text(text, encoding="utf-8")
    yield (sentence := refuse(lambda: run_seeds(study, 1)))
    (table,) = read_quoted(sentence, "add the table")
    study.write_text(f"{text}[{table}]{tests}", encoding="utf-8")
    yield refuse(lambda: run_seeds(study, 1))


def friction_of_seeds(place: Place) -> Iterator[str]:
    study = place.folder / "study.toml"
    text = read_study(place).replace("motions.toml", str(place.results.parent / "motions.toml"))
    study.write_text(write_line(text, "twin", "truth", "'strain_wave'"), encoding="utf-8")
    yield (sentence := refuse(lambda: run_seeds(study, 1)))
    (key,) = read_quoted(sentence, "remove the key")
    assert key == "twin.truth"
    study.write_text(text, encoding="utf-8")
    yield refuse(lambda: run_seeds(study, 1))


def laws_of_seeds(place: Place) -> Iterator[str]:
    study = write_study(place.folder)
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace("laws = ", "# laws = "), encoding="utf-8")
    yield (sentence := refuse(lambda: run_seeds(study, 20)))
    key, _ = read_quoted(sentence, "needs the key")
    assert re.search(rf"(?m)^{key} = ", text)
    study.write_text(text, encoding="utf-8")
    yield refuse(lambda: run_seeds(study, 1))


def table_of_a_loop(place: Place) -> Iterator[str]:
    study = write_study(place.folder)
    output = place.folder / "loop"
    yield (sentence := refuse(lambda: hesr.export(study, output, format="loop")))
    tables = re.findall(r"\[(\w+)\]", sentence)
    assert all(f"[{table}]" in read_study(place) for table in tables)
    yield refuse(lambda: hesr.export(place.results, output, format="loop"))


def source_of_a_constant(place: Place) -> Iterator[str]:
    """Torque constants without a source: the phrase is said until the robot file states it."""
    values = signals()
    columns = [values[name] for name in ("t", "q", "dq", "amperes")]
    log = place.folder / "run.csv"
    header = "t,q1,dq1,i1"
    np.savetxt(log, np.column_stack(columns), "%.9g", ",", header=header, comments="")
    robot = place.bench / "robot.toml"
    text = write_line(robot.read_text(encoding="utf-8"), "log", "torque_per_ampere", "[0.11]")

    def identify(robot_text: str) -> str:
        robot.write_text(robot_text, encoding="utf-8")
        return place.run("identify", log, "--robot", robot).out

    yield (sentence := identify(text))
    (table,) = read_quoted(sentence, "under")
    yield identify(write_line(text, table, "torque_per_ampere", "'measured'"))


def commands_instead_of_torque(place: Place) -> Iterator[str]:
    """A log of commands: a command that needs torque names the one that does not."""
    draw_hobby_servo(place.folder, 3, rate=100.0).write_log(place.folder / "log.csv")
    robot = place.folder / "robot.toml"
    log = place.folder / "log.csv"
    yield (sentence := refuse(lambda: hesr.inspect(log, robot=robot, torque_constants=True)))
    assert re.findall(r"'hesr (\w+)'", sentence) == ["fit", "identify"]
    refusals = [
        refuse(lambda: hesr.fit(log, robot=robot, law="coulomb_viscous")),
        refuse(lambda: hesr.identify(log, robot=robot)),
    ]
    yield "".join(refusals)


def options_of_a_body_from_commands(place: Place) -> Iterator[str]:
    """A log of commands: options that need torques are left out."""
    draw_hobby_servo(place.folder, 3, rate=100.0).write_log(place.folder / "log.csv")
    options = {"robot": place.folder / "robot.toml", "method": "paper", "body": "free"}

    def identify() -> str:
        return refuse(lambda: hesr.identify(place.folder / "log.csv", **options))

    yield (sentence := identify())
    for name in read_quoted(sentence, "leave out"):
        options.pop(name, None)
    assert list(options) == ["robot"]
    yield identify()


def find_public_model(place: Place, model: str, **options: Path | None) -> str:
    """Look for the model of a repository, whose files are those of a clone."""
    source: Any = SimpleNamespace(repository="owner/logs", model=model)
    robot = options.get("robot")
    return refuse(lambda: _find_model(source, place.folder, robot))


def model_of_public_logs(place: Place) -> Iterator[str]:
    given = {"robot": place.bench / "bench.urdf"}
    yield (sentence := find_public_model(place, "arm.urdf", **given))
    (option,) = read_quoted(sentence, "leave")
    del given[option]
    yield find_public_model(place, "arm.urdf", **given)


def missing_model_of_public_logs(place: Place) -> Iterator[str]:
    yield (sentence := find_public_model(place, ""))
    (option,) = read_quoted(sentence, "as")
    yield find_public_model(place, "", **{option: place.bench / "bench.urdf"})


def law_alone(place: Place) -> Iterator[str]:
    draw_hobby_servo(place.folder, 3, rate=100.0).write_log(place.folder / "log.csv")
    robot = place.folder / "robot.toml"

    def fit(**arguments: Any) -> str:
        return refuse(lambda: hesr.fit(place.folder / "log.csv", robot=robot, **arguments))

    yield (sentence := fit(law="coulomb_viscous", add="temperature"))
    name, *excluded = read_quoted(sentence, "give the name of")
    assert excluded == ["options", "add", "prior"]
    yield fit(**{name: "coulomb_viscous"})


EXECUTED: dict[str, Callable[[Place], Iterator[str]]] = {
    "do not name their robot; give": name_of_robot,
    "give 'robot' to read this log": robot_of_a_path,
    "does not name its robot; give": robots_of_logs,
    "of 'hesr identify', which separates": body_of_a_law,
    "takes a log, or the arrays": arrays_of_a_prediction,
    "no band; fit the model": band_of_a_law,
    "coefficients have no covariance": covariance_of_a_prior,
    "body with body = ": body_of_a_plant,
    'set body = "physical" in': body_of_a_study,
    "model of its own": model_of_public_logs,
    "that of the robot as": missing_model_of_public_logs,
    "which this command needs; without it": commands_instead_of_torque,
    "no torque; leave out": options_of_a_body_from_commands,
    "torque; give the name of": law_alone,
    "has no 'unit'; give it": unit_of_a_coefficient,
    "state; add it to 'coefficients'": coefficient_of_a_law,
    "use the 'symbol' of a coefficient": symbol_of_a_law,
    "add it to 'bounds' to search": space_of_a_law,
    "nothing is varied: give": inputs_of_a_sweep,
    "determines the number of runs; remove": runs_of_a_grid,
    "needs the key 'runs'": runs_of_a_design,
    "needs a power of 2 as": power_of_two,
    "a grid needs 'values'": range_of_a_grid,
    "needs one of 'values'": distribution_of_an_input,
    "no results of 'hesr run'": results_to_read,
    "give a result of 'hesr run'": results_to_view,
    "no such file; rerun 'hesr run'": arm_to_view,
    "for a study with [tracking]": traces_to_view,
    "study with [twin] and [tracking]": loop_to_copy,
    "alternative plants need the key": plant_of_a_study,
    "'tracking' needs the keys": tracking_of_a_study,
    "needs test sets; add the table": logs_of_seeds,
    "remove the key 'twin.truth'": friction_of_seeds,
    "needs the key 'laws'": laws_of_seeds,
    "which a loop needs; add it": table_of_a_loop,
    "in the robot file, under": source_of_a_constant,
}
"""Statements, by words of them, and what provokes and mends each."""


@pytest.mark.parametrize("words", EXECUTED)
def test_a_printed_remedy_makes_its_statement_go_away(words: str, place: Place) -> None:
    before, after = EXECUTED[words](place)
    assert words in before
    assert words not in after, after
