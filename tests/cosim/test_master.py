"""The master: call order, results kept after a failure, and release of every FMU."""

from pathlib import Path

import numpy as np
import pytest
from containing import Containing
from fakes import Fake
from pythonfmu.builder import FmuBuilder

from cosim.systems.simulation import Master, System
from cosim.systems.system import SystemSpec
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.master import ExchangeScheme
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.logs.tables import read_table


def run(spec):
    with Master(spec) as master:
        return master.run()


def steps_of(name):
    return [call[1:] for call in Fake.calls if call[0] == name and call[1] != "start"]


# --- call order --------------------------------------------------------------------------------


def test_a_component_gets_the_newest_outputs(fakes):
    """Gauss-Seidel: the integrator after a clock gets the clock's y[k+1] in the same step."""
    spec = fakes(
        {"clock": "clock", "sum": "fake"},
        {"sum.u[1]": "clock.y", "sum.u[2]": "sum.y[1]"},
        observe=["sum.y"],
    )
    result = run(spec).require_success()
    np.testing.assert_allclose(result.t, 0.1 * np.arange(11), rtol=1e-15)
    y = np.concatenate([[0.0], np.cumsum(0.1 * 0.1 * np.arange(1, 11))])
    np.testing.assert_allclose(result.vector("sum.y")[:, 0], y, rtol=1e-13)
    # Its own output is that of the previous step.
    z = np.concatenate([[0.0], np.cumsum(0.1 * y[:-1])])
    np.testing.assert_allclose(result.vector("sum.y")[:, 1], z, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("first", ["clock", "sum"])
def test_jacobi_uses_values_at_the_start_in_any_order(fakes, first):
    names = {"clock": "clock", "sum": "fake"}
    spec = fakes(
        {first: names[first]} | names,
        {"sum.u[1]": "clock.y", "sum.u[2]": "clock.y"},
        observe=["sum.y"],
        order="jacobi",
    )
    y = np.concatenate([[0.0], np.cumsum(0.1 * 0.1 * np.arange(10))])
    np.testing.assert_allclose(run(spec).vector("sum.y")[:, 0], y, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_connected_values_are_converted_in_order(fakes, order):
    spec = fakes(
        {"clock": "clock", "sum": "fake"},
        {"sum.u[1]": "clock.y", "sum.u[2]": "clock.y"},
        observe=["sum.y"],
        order=order,
        conversions={
            "sum.u[1]": ({"factor": 2.0, "offset": 1.0}, {"factor": 0.5}),
            "sum.u[2]": ({"table": {0.1: 7.0}},),
        },
    )
    clock = 0.1 * (np.arange(1, 11) if order == "gauss_seidel" else np.arange(10))
    first = np.cumsum(0.1 * (2.0 * clock + 1.0) * 0.5)
    second = np.cumsum(0.1 * np.where(np.isclose(clock, 0.1), 7.0, clock))
    y = run(spec).vector("sum.y")[1:]
    np.testing.assert_allclose(y, np.column_stack([first, second]), rtol=1e-13)


def test_components_step_in_their_order_by_a_step_counter(fakes):
    run(fakes({"b": "clock", "a": "clock"}, stop=0.7, observe=["a.y"]))
    starts = [("b", "start"), ("a", "start")]
    steps = [(name, k * 0.1, 0.1) for k in range(7) for name in ("b", "a")]
    assert Fake.calls == starts + steps  # exactly: time is never summed


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_steps_end_at_given_communication_points(fakes, order):
    times = np.array([0.0, 0.25, 0.5, 2.0])
    spec = fakes({"clock": "clock"}, stop=0.3, observe=["clock.y"], order=order)
    with Master(spec, times=times) as master:
        result = master.run().require_success()
    assert steps_of("clock") == [(0.0, 0.25), (0.25, 0.25), (0.5, 1.5)]
    assert result.t.tolist() == result.signals["clock.y"].tolist() == times.tolist()


@pytest.mark.parametrize("order", ["gauss_seidel", "jacobi"])
def test_components_may_have_different_rates(fakes, order):
    spec = fakes(
        {
            "clock": "clock",
            "slow": {"fmu": "fake", "step": 0.3},
            "slower": {"fmu": "clock", "step": 0.6},
        },
        {"slow.u[1]": "clock.y", "slow.u[2]": "slower.y"},
        stop=1.2,
        observe=["slow.y", "slower.y"],
        order=order,
    )
    result = run(spec).require_success()
    np.testing.assert_allclose(steps_of("slow"), [(0.3 * k, 0.3) for k in range(4)], atol=1e-15)
    np.testing.assert_allclose(steps_of("slower"), [(0, 0.6), (0.6, 0.6)], atol=1e-15)
    # Held between its steps; inputs are those at the end of the step, with Jacobi at its start.
    inputs = 0.3 * np.arange(1, 5) if order == "gauss_seidel" else 0.3 * np.arange(4)
    y = np.repeat(np.concatenate([[0.0], np.cumsum(0.3 * inputs)]), 3)[:13]
    np.testing.assert_allclose(result.vector("slow.y")[:, 0], y, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(
        result.vector("slower.y")[:, 0], [0.0] * 6 + [0.6] * 6 + [1.2], atol=1e-15
    )


def test_values_pass_through_chains_before_the_first_step(fakes):
    """Twice through the same component, against the listed order."""
    spec = fakes(
        {"last": "gain", "pair": "pair", "middle": "gain",
         "source": {"fmu": "fake", "start": {"y0": 3.0}}},
        {"pair.a": "source.y[1]", "middle.u": "pair.b", "pair.c": "middle.y", "last.u": "pair.d",
         "source.u[1]": "last.y", "source.u[2]": "last.y"},
        observe=["pair.b", "pair.d", "last.y"],
    )  # fmt: skip
    signals = run(spec).signals
    assert [signals[name][0] for name in spec.observe] == [6.0, 24.0, 48.0]


def test_values_settle_before_the_first_step_without_declared_dependencies(fakes):
    """Each of four gains hides its dependency on the previous one; one pass is not enough."""
    names = ["d", "c", "b", "a"]
    spec = fakes(
        dict.fromkeys(names, "hidden") | {"source": {"fmu": "fake", "start": {"y0": 3.0}}},
        {"a.u": "source.y[1]", "b.u": "a.y", "c.u": "b.y", "d.u": "c.y",
         "source.u[1]": "d.y", "source.u[2]": "d.y"},
        observe=[f"{n}.y" for n in names],
    )  # fmt: skip
    signals = run(spec).signals
    assert [signals[f"{n}.y"][0] for n in names] == [48.0, 24.0, 12.0, 6.0]


@pytest.mark.parametrize("refreshed", ["none", "shown", "all"])
def test_refreshed_outputs_follow_the_inputs_of_their_instant(fakes, refreshed):
    """A gain of the time feeds an integrator; only "all" also passes its new output on."""
    spec = fakes(
        {"clock": "clock", "gain": "gain", "sum": "fake"},
        {"gain.u": "clock.y", "sum.u[1]": "gain.y", "sum.u[2]": "gain.y"},
        observe=["gain.y", "sum.y"],
    )
    scheme = ExchangeScheme(order="jacobi", refreshed=refreshed)
    with Master(spec, scheme=scheme) as master:
        found = master.run()
    time = 0.1 * np.arange(11)
    late = 2.0 * np.maximum(time - 0.1, 0.0)
    shown = late if refreshed == "none" else 2.0 * time
    passed_on = 2.0 * time if refreshed == "all" else late
    np.testing.assert_allclose(found.signals["gain.y"], shown, atol=1e-14)
    integral = np.concatenate([[0.0], np.cumsum(0.1 * passed_on)[:-1]])
    np.testing.assert_allclose(found.vector("sum.y")[:, 0], integral, atol=1e-14)


@pytest.mark.parametrize(
    ("first", "refreshed", "rows"),
    [
        ("propagated", "none", [(3.0, 6.0), (3.6, 6.0)]),
        ("zero", "none", [(0.0, 0.0), (3.0, 0.0), (3.0, 6.0)]),
        ("zero", "shown", [(3.0, 0.0), (3.0, 6.0), (3.0, 6.0)]),
    ],
)
def test_the_first_inputs_are_zero_or_propagated(fakes, first, refreshed, rows):
    spec = fakes(
        {"source": {"fmu": "fake", "start": {"y0": 3.0}}, "gain": "gain"},
        {"gain.u": "source.y[1]", "source.u[1]": "gain.y", "source.u[2]": "gain.y"},
        observe=["source.y[1]", "gain.y"],
    )
    scheme = ExchangeScheme(order="jacobi", first=first, refreshed=refreshed)
    with Master(spec, scheme=scheme) as master:
        found = master.run()
    values = np.column_stack([found.signals["source.y[1]"], found.signals["gain.y"]])
    np.testing.assert_allclose(values[: len(rows)], rows, atol=1e-14)


# --- results -----------------------------------------------------------------------------------


def test_runs_of_one_master_are_identical(fakes):
    spec = fakes(
        {"a": {"fmu": "fake", "start": {"y0": 1.0}}, "b": "fake"},
        {"a.u": "b.y", "b.u": "a.y"},
        observe=["a.y", "b.y"],
    )
    with Master(spec) as master:
        first = master.run()
        other = master.run(start={"a": {"y0": 2.0}})
        again = master.run()
    for name, values in first.signals.items():
        np.testing.assert_array_equal(values, again.signals[name])
        np.testing.assert_allclose(other.signals[name], 2.0 * values, rtol=1e-14)


@pytest.mark.parametrize("kind", ["failing", "broken"])
def test_a_failure_ends_the_run_and_keeps_earlier_rows(fakes, kind):
    spec = fakes(
        {"sum": "fake", "late": kind},
        {"sum.u[1]": "late.y", "sum.u[2]": "late.y"},
        observe=["sum.y", "late.y"],
    )
    with Master(spec) as master:
        result = master.run()
        said = str(result.failure)
        if kind == "failing":
            assert said == "'late' at t = 0.3 s: too late."
            rows = 4
        else:
            assert "t = 0.3 s late.y is not" in said
            rows = 3
        np.testing.assert_allclose(result.t, 0.1 * np.arange(rows), rtol=1e-15)
        np.testing.assert_allclose(result.vector("late.y")[:, 0], 0.1 * np.arange(rows))
        with pytest.raises(SimulationError, match=r"at t = 0\.3 s"):
            result.require_success()
        assert str(master.run().failure) == said  # and the system can be run again
    assert not Fake.alive


def test_the_source_of_nan_is_named(fakes):
    spec = fakes(
        {"late": "broken", "sum": "fake"},
        {"sum.u[1]": "late.y", "sum.u[2]": "late.y"},
    )
    assert "t = 0.3 s late.y is not" in str(run(spec).failure)


def test_nan_at_the_start_is_named_with_its_time(fakes):
    spec = fakes(
        {"gain": {"fmu": "gain", "start": {"u": 1e308}}, "sum": "fake"},
        {"sum.u[1]": "gain.y", "sum.u[2]": "gain.y"},
    )
    assert "t = 0 s gain.y is not" in str(run(spec).failure)


def test_names_in_a_study_are_checked_against_the_system(fakes):
    asked = Path("study.toml")
    links = {"sum.u[1]": "clock.y", "sum.u[2]": "clock.y"}
    spec = fakes({"sum": "fake", "clock": "clock"}, links, observe=["sum.y", "clock.y"])
    with Master(spec) as master:
        master.require_start({"sum": {"y0": 1.0}}, asked)
        for start, said in (
            ({"sum": {"y[2]": 1.0}}, "'sum.y[2]' cannot be varied: its FMU"),
            ({"sum": {"y": [1.0, 2.0]}}, "'sum.y[1]' cannot be varied: its FMU"),
            ({"some": {"y0": 1.0}}, "system: start values: there is no component 'some'"),
        ):
            with pytest.raises(ConfigError) as error:
                master.require_start(start, asked)
            assert str(error.value).startswith(f"study.toml: {said}")
        master.require_same_size("sum.y", "sum.y", asked)
        for one, other, counts in (("sum.y", "clock.y", (2, 1)), ("clock.y", "sum.y", (1, 2))):
            with pytest.raises(ConfigError) as error:
                master.require_same_size(one, other, asked)
            assert str(error.value) == (
                f"study.toml: '{one}' has {counts[0]} elements and its reference "
                f"'{other}' {counts[1]}."
            )


def test_limits_end_a_run(fakes):
    spec = fakes(
        {"sum": {"fmu": "fake", "start": {"u": [1.0, -2.0]}}},
        observe=["sum.y"],
        limits={"sum.y": [-1.1, 1.1]},
    )
    result = run(spec)
    assert str(result.failure) == Containing("t = 0.6 s sum.y[2] is -1.2", "limits -1.1 to 1.1")
    # The row that exceeds its limits is also kept.
    np.testing.assert_allclose(result.vector("sum.y")[-1], [0.6, -1.2])


def test_limits_apply_at_the_start(fakes):
    spec = fakes(
        {"sum": {"fmu": "fake", "start": {"u": 0.0, "y0": 2.0}}}, limits={"sum.y": [-1.0, 1.0]}
    )
    assert "0 s sum.y[1] is 2, outside" in str(run(spec).failure)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_results_are_written(fakes, tmp_path, suffix):
    spec = fakes({"clock": "clock"}, observe=["clock.y"])
    result = run(spec)
    result.write(tmp_path / f"result.{suffix}")
    table = read_table(tmp_path / f"result.{suffix}")
    assert table.names == ("t", "clock.y")
    np.testing.assert_array_equal(
        table.numbers(table.names), np.column_stack([result.t, result.signals["clock.y"]])
    )


def test_unobserved_signals_are_refused(fakes):
    result = run(fakes({"clock": "clock"}, observe=["clock.y"]))
    with pytest.raises(SimulationError, match=r"signal 'clock.z' has not been observed\."):
        result.vector("clock.z")


def test_progress_is_reported(fakes):
    told = []
    spec = fakes({"clock": "clock"}, stop=50.0)
    with Master(spec) as master:
        master.run(lambda done, steps: told.append((done, steps)))
    assert told == [(0, 500), (200, 500), (400, 500), (500, 500)]


# --- release -----------------------------------------------------------------------------------


def test_every_component_is_freed(fakes):
    with Master(fakes({"a": "clock", "b": "clock"})) as master:
        assert Fake.alive == {"a", "b"}
        master.run()
    assert not Fake.alive


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), ValueError(), SimulationError("it is off.")]
)
def test_every_component_is_freed_after_an_error(fakes, error):
    def use():
        with Master(fakes({"a": "clock", "b": "clock"}, stop=50.0)) as master:

            def stop(done, steps):
                raise error

            master.run(stop)
            raise error

    with pytest.raises(type(error)):
        use()
    assert not Fake.alive


def test_every_component_is_freed_if_the_system_does_not_fit(fakes):
    spec = fakes({"a": "clock", "b": "fake"})
    with pytest.raises(ConfigError, match=r"^system: input 'b.u\[1\]' is not connected"):
        System(spec, Path("system")).run()
    assert not Fake.alive


def test_components_are_freed_if_another_cannot_be_loaded(lag_fmu, tmp_path, monkeypatch):
    freed = []
    free = FmuInstance._free

    def noted(self, *error):
        freed.append(self.name)
        free(self, *error)

    monkeypatch.setattr(FmuInstance, "_free", noted)
    spec = SystemSpec.model_validate(
        {
            "step": 0.1,
            "stop": 1.0,
            "components": [
                {"name": "one", "fmu": lag_fmu},
                {"name": "two", "fmu": lag_fmu},
                {"name": "three", "fmu": tmp_path / "missing.fmu"},
            ],
        }
    )
    with pytest.raises(SimulationError, match=r"missing\.fmu: no such file\."):
        System(spec, tmp_path).run()
    assert freed == ["two", "one"]


# --- FMUs -------------------------------------------------------------------------------------


def test_refused_steps_are_reported(lag_fmu, tmp_path):
    spec = SystemSpec.model_validate(
        {
            "step": 0.1,
            "stop": 1.0,
            "components": [
                {"name": "a", "fmu": lag_fmu, "start": {"u": 1.0, "refused": 0.45}},
                {"name": "b", "fmu": lag_fmu},
            ],
            "connections": {"b.u": "a.y"},
            "observe": ["a.y", "b.y"],
        }
    )
    with Master(spec) as master:
        for _ in range(2):
            result = master.run()
            assert str(result.failure) == (
                "Lag.fmu ('a') at t = 0.4 s: The step passes 0.45 s, where it is refused."
            )
            assert len(result.t) == len(result.signals["b.y"]) == 5
    result.write(tmp_path / "result.csv")
    assert len(read_table(tmp_path / "result.csv").numbers(["t"])) == 5


def test_failed_starts_are_reported(lag_fmu):
    spec = SystemSpec.model_validate(
        {
            "step": 0.1,
            "stop": 1.0,
            "components": [{"name": "a", "fmu": lag_fmu, "start": {"u": 1.0, "T": -1.0}}],
            "observe": ["a.y"],
        }
    )
    with Master(spec) as master:
        result = master.run()
    assert str(result.failure) == "Lag.fmu ('a') at t = 0 s: T is -1 s; it must be positive."
    assert len(result.t) == 0


@pytest.fixture(scope="module")
def odd_fmu(tmp_path_factory):
    """An FMU of another exporter."""
    script = Path(__file__).with_name("odd_slave.py")
    return Path(FmuBuilder.build_FMU(script, dest=tmp_path_factory.mktemp("odd")))


def odd_system(fmu, **more):
    start = {"u": 1.0, "on": True, "times": 3, "text": "four"}
    data = {
        "step": 0.1,
        "stop": 1.0,
        "components": [{"name": "odd", "fmu": fmu, "start": start}],
        "observe": ["odd.y"],
    }
    return SystemSpec.model_validate(data | more)


def test_silent_nan_is_reported_with_parameters_of_every_type(odd_fmu):
    with Master(odd_system(odd_fmu)) as master:
        for _ in range(2):
            result = master.run()
            np.testing.assert_array_equal(result.signals["odd.y"], [0.0, 12.0, 12.0])
            assert "t = 0.3 s odd.y is not" in str(result.failure)


def test_undeclared_dependencies_count_as_feedthrough(odd_fmu):
    spec = odd_system(odd_fmu, connections={"odd.u": "odd.y"})
    with pytest.raises(ConfigError) as error:
        System(spec, Path("system")).run()
    assert "algebraic loop through direct feedthrough: odd." in str(error.value)
    assert "('odd' does not say what its outputs depend on: every input" in str(error.value)


def test_overflow_is_reported_with_the_variable(lag_fmu):
    start = {"u": -1e308, "x_start": 1e308, "T": 1e3}
    spec = SystemSpec.model_validate(
        {
            "step": 0.1,
            "stop": 1.0,
            "components": [{"name": "a", "fmu": lag_fmu, "start": start}],
            "observe": ["a.y"],
        }
    )
    with pytest.raises(SimulationError, match=r"^Lag\.fmu \('a'\) at t = 0 s: .*inf"):
        System(spec, Path("system")).run()


# --- the file ---------------------------------------------------------------------------------


GOOD = """
step = 0.1
stop = 1.0
[[components]]
name = "a"
fmu = "folder/A.fmu"
[[components]]
name = "b"
fmu = "B.fmu"
"""


def test_fmu_paths_are_relative_to_the_toml_file(tmp_path):
    path = tmp_path / "system.toml"
    path.write_text(GOOD)
    spec = SystemSpec.read(path)
    assert [c.fmu for c in spec.components] == [tmp_path / "folder/A.fmu", tmp_path / "B.fmu"]
    assert (spec.steps, spec.find_step_multiple(spec.components[0])) == (10, 1)


MANY = "".join(f'name = "c{k}"\nfmu = "B.fmu"\n\n[[components]]\n' for k in range(1000))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "stop = 1.0",
            "stop = 1.03",
            "the stop time is 1.03 s",
        ),
        (
            '"B.fmu"',
            '"B.fmu"\nstep = 0.25',
            "step of 'b' is 0.25 s",
        ),
        (
            '"B.fmu"',
            '"B.fmu"\nstep = 0.05',
            "step of 'b' is 0.05 s",
        ),
        ('name = "b"', 'name = "a"', "two components are named 'a'."),
        ('name = "b"', 'name = "b.c"', "key 'components.1.name' is 'b.c'"),
        ('name = "b"', f'{MANY}name = "b"', "at most 1000 items after validation"),
        ("step = 0.1", "step = 0.0", "key 'step' is 0.0: Input should be greater than 0."),
        ("stop = 1.0", 'stop = 1.0\norder = "random"', "key 'order' is 'random': Input should be"),
        ("stop = 1.0", "stop = 1.0\nstopp = 2.0", "unknown key 'stopp'; did you mean 'stop'"),
        ("stop = 1.0", 'stop = 1.0\nobserve = ["a"]', "key 'observe.0' is 'a'"),
        (
            "stop = 1.0",
            'stop = 1.0\nlimits = {"a.y" = [1.0, 1.0]}',
            "the limits 1 and 1",
        ),
        ("stop = 1.0", "", "key 'stop' is missing."),
    ],
)
def test_invalid_files_are_refused(tmp_path, old, new, said):
    path = tmp_path / "system.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError) as error:
        SystemSpec.read(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)
