"""One FMU, run by FMPy."""

import numpy as np
from files import case, leave
from fmpy import simulate_fmu

given = case()
arrays = given["arrays"]
owner = {element: name for name, elements in arrays.items() for element in elements}


def columns(names: list[str]) -> dict[str, list[str]]:
    """Return the elements of each array variable among these names."""
    return {owner.get(name, name): arrays.get(owner.get(name), [name]) for name in names}


def shape(name: str) -> tuple[int, ...]:
    """Return the shape of a variable from the indices of its last element."""
    if name not in arrays:
        return ()
    return tuple(map(int, arrays[name][-1].rpartition("[")[2].rstrip("]").split(",")))


inputs = None
if given["inputs"]:
    table = np.zeros(
        len(given["times"]),
        dtype=[("time", np.float64)]
        + [(name, np.float64, shape(name)) for name in columns([*given["inputs"]])],
    )
    table["time"] = given["times"]
    for name, elements in columns([*given["inputs"]]).items():
        values = np.column_stack([given["inputs"][element] for element in elements])
        table[name] = values.reshape(-1, *shape(name))
    inputs = table
result = simulate_fmu(
    given["fmu"],
    stop_time=given["stop"],
    output_interval=given["step"],
    start_values={
        name: [given["start"][e] for e in elements] if name in arrays else given["start"][name]
        for name, elements in columns([*given["start"]]).items()
    },
    input=inputs,
    output=[*columns(given["outputs"])],
    fmi_type="CoSimulation",
    use_event_mode=False,
)
found = {
    element: values
    for name, elements in columns(given["outputs"]).items()
    for element, values in zip(elements, result[name].reshape(len(result), -1).T, strict=True)
}
leave(
    given["outputs"],
    zip(result["time"], *(found[name] for name in given["outputs"]), strict=True),
)
