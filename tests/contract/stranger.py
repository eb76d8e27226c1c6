"""A user script with every public function and class; `mypy --strict` checks it."""

from pathlib import Path

import numpy as np

import hesr


def classes() -> None:
    robot = hesr.Robot("robot.toml")
    log = hesr.Log.read(Path("sweep.csv"), robot)
    body = hesr.RigidBody.read("body.json")
    body.write(Path("copy.json"))
    model = hesr.FrictionModel.read("law.json")
    model.write("copy.json")
    torque = model.predict(t=np.zeros(3), dq=np.zeros((3, 2)))
    regressor = hesr.FrictionRegressor(law="lugre").fit(log)
    print(regressor.score(log), regressor.equation(), torque.shape, log.name, robot.n)


def fmus() -> None:
    fmu = hesr.Fmu(Path("F.fmu"), trust=True)
    units = {name: variable.unit for name, variable in fmu.variables.items()}
    if fmu.model is not None:
        print(fmu.model.law)
    print(units, fmu.replay(t=np.zeros(3), dq=np.zeros((3, 2))).shape)
    with fmu.instance() as friction:
        friction.initialise(start={"dq[1]": 0.2})
        friction.step(0.0, 0.005)
        print(friction.get(["tau[1]"]).shape)
    signals = hesr.System.read("loop.toml").run()
    signals.write("result.csv")
    print(signals.t.shape, signals.signals["a.y"].shape, hesr.check(fmu).passed)


def verbs() -> None:
    made = hesr.new("folder", Path("arm.urdf"), joints=("a",))
    print(made.folder, made.joints)
    inspection = hesr.inspect("log.csv", robot="robot.toml", write="robot.toml")
    print([finding.sentence for finding in inspection.findings], inspection.passed)
    design = hesr.excite("robot.toml", output="motion.csv")
    print(design.forward)
    body = hesr.identify(["a.csv", Path("b.csv")], robot="robot.toml", physical=True)
    model = hesr.fit("a.csv", law="lugre", robot="robot.toml", rigid_body=body, options={"a": 1})
    report = hesr.test({"own": model}, on=["b.csv"], rigid_body=body, load=1.0)
    print(report.summary(), report.findings, report.scores)
    path = hesr.export(model, "F.fmu", platform=("linux64",), fmi=3, power=True)
    drive = hesr.export(model, Path("D.fmu"), format="drive", inertia=[1.0, 2.0])
    print(path.name, drive.name, hesr.check([path], kind=("hostile",)).to_json())
    run = hesr.simulate("loop.toml", output="result.csv")
    print(run.t if isinstance(run, hesr.Signals) else run.summary())
    print(hesr.run("study.toml", quick=True).outcome.fmus["lugre"].name)
    print(hesr.run(seeds=3))
    print(hesr.run("paper").summary())
    print(hesr.report("results", output="page.html").name)
    print(hesr.monitor(["a.csv"], law=model, rigid_body=body).summary())
    print(hesr.laws()["lugre"].title)


def one_or_several() -> None:
    """One item, or several in any iterable, wherever a parameter takes several."""
    path = Path("a.csv")
    print(hesr.check(path for path in ("a.fmu", "b.fmu")).passed)
    print(hesr.identify({path: 1}.keys(), robot="robot.toml", accept="duplicate").joints)
    model = hesr.fit(path, law="lugre", robot="robot.toml", add="temperature")
    adapted = hesr.fit(iter([path]), prior=model, robot="robot.toml")
    print(hesr.test((law for law in (model, adapted)), on=path, kind="passivity").passed)
    print(hesr.test(model, inertia=np.array([1.0, 2.0]), kind=iter(["properties"])).passed)
    print(hesr.export(model, "F.fmu", platform="linux64", calibration=path, kv=iter([1.0])))
    print(hesr.new("folder", "arm.urdf", joints="a, b", gear_ratio=(x for x in (1.0, 2.0))).joints)
    print(hesr.inspect(path, joints="a", loaded=path, payload=(1.0, 0.0, 0.0, 0.1)).passed)
    print(hesr.report((Path(name) for name in "ab"), law="lugre", output="page.md"))
    print(hesr.simulate("F.fmu", set="gain=2"))
    print(hesr.run("study.toml", platform="win64", accept=iter(["duplicate"])).summary())
    print(hesr.monitor(path, law=model, accept="duplicate").summary())
    print(len(hesr.observe(path, law=model, calibration=path, accept="duplicate")))
    print(hesr.FrictionRegressor().fit(iter([path])).to_fmu("F.fmu", platforms="linux64"))


def errors() -> None:
    try:
        hesr.check("none.fmu")
    except hesr.HesrError as error:
        print(str(error))
