"""One FMU, or a system of FMUs, run by PyFMI; a system by its Master with fixed steps."""

import time
from collections.abc import Sequence
from typing import Any

from files import case, leave
from pyfmi import Master, load_fmu

Rows = Sequence[Sequence[float]]


def loaded(fmu: str, start: dict[str, Any]) -> Any:
    """Return an FMU with its start values set."""
    model = load_fmu(fmu, kind="CS")
    for name, value in start.items():
        model.set(name, value)
    return model


def alone(given: dict[str, Any]) -> tuple[Rows, float]:
    """Return time, outputs and duration of an FMU with inputs held over each step."""
    model = loaded(given["fmu"], given["start"])
    inputs, step = list(given["inputs"]), given["step"]
    table = list(zip(*given["inputs"].values(), strict=True)) or [()] * len(given["times"])
    rows: list[list[float]] = []

    def put(values: Sequence[float]) -> None:
        for name, value in zip(inputs, values, strict=True):
            model.set(name, value)

    def keep(at: float) -> None:
        rows.append([at, *(float(model.get(name)[0]) for name in given["outputs"])])

    model.setup_experiment(start_time=0.0, stop_time_defined=True, stop_time=given["stop"])
    model.enter_initialization_mode()
    put(table[0])
    model.exit_initialization_mode()
    keep(0.0)
    begin = time.perf_counter()
    for k, at in enumerate(given["times"][:-1]):
        put(table[k])
        if status := model.do_step(at, step, True):
            raise SystemExit(f"the step from {at} s ended with status {status}")
        keep(given["times"][k + 1])
    return rows, time.perf_counter() - begin


def together(given: dict[str, Any]) -> tuple[Rows, float]:
    """Return time, signals and duration of a system, including initialisation."""
    models = {name: loaded(*part) for name, part in given["components"].items()}
    links = [(models[a], out, models[b], into) for a, out, b, into in given["connections"]]
    master = Master([*models.values()], links)
    options = master.simulate_options()
    options["step_size"] = given["step"]
    options["result_handling"] = "memory"
    # Otherwise initial inputs are solved for, as accurately as the solver allows.
    options["block_initialization"] = True
    begin = time.perf_counter()
    # A last step of round-off size must be skipped; round-off may also shorten a real one.
    end = (given["steps"] + 1e-10) * given["step"]
    found = master.simulate(0.0, end, options=options)
    seconds = time.perf_counter() - begin
    parts = (signal.partition(".") for signal in given["signals"])
    columns = [found[models[name]][variable] for name, _, variable in parts]
    times = [k * given["step"] for k in range(given["steps"] + 1)]
    return [[t, *(column[k] for column in columns)] for k, t in enumerate(times)], seconds


def main() -> None:
    """Run a case."""
    given = case()
    whole = "components" in given
    rows, seconds = together(given) if whole else alone(given)
    leave(given["signals" if whole else "outputs"], rows, seconds)


if __name__ == "__main__":
    main()
