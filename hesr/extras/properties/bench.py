"""Benches that move the joints of a friction FMU, or drive those of a JointDrive."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from fmu_src.friction.friction_component import GIVEN, START_MODE
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from fmu_src.run.variables import Value
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import INPUTS
from hesr_model.support.arrays import Array

DISCRETISATION = "discretisation"
_EXACT = 1.0
_MAX_SUBSTEP = 5e-3  # [s] without exact integration
_EXACT_SLIDING_TIME = 1e4  # [s] of steady sliding with exact integration
_SLIDING_TIME = 60.0  # [s] of steady sliding without


def _name_elements(vector_names: Sequence[str], joints: int) -> list[str]:
    """Return the names of the elements of vectors, numbered from 1, one vector after another."""
    numbers = range(1, joints + 1)
    return [f"{name}[{number}]" for name, number in product(vector_names, numbers)]


class _Bench:
    """An FMU with vectors of inputs and outputs, stepped from its own time zero."""

    def __init__(
        self, instance: FmuInstance, joints: int, inputs: Sequence[str], outputs: Sequence[str]
    ) -> None:
        self.joints = joints
        self._instance = instance
        self._inputs = instance.buffer(_name_elements(inputs, joints))
        self._outputs = instance.buffer(_name_elements(outputs, joints))
        self._rows = self._inputs.values.reshape(len(inputs), joints)
        self._time = 0.0

    def _start(self, start: Mapping[str, float | str]) -> None:
        if self._instance.used:
            self._instance.reset()
        self._instance.initialise(start=start, inputs=self._inputs)
        self._time = 0.0

    def _step(self, dt: float) -> Array:
        self._inputs.write()
        self._instance.step(self._time, dt)
        self._time += dt
        return self._outputs.read()

    def _hold_rows(self, dt: Array, rows: Array) -> Array:
        """Hold each row of inputs for its time (K,) [s]; return the outputs at the ends."""
        times = np.cumsum(np.concatenate([[self._time], dt]))
        outputs = step_rows(self._instance, self._inputs, self._outputs, times[:-1], dt, rows)
        self._inputs.values[:] = rows[-1]
        self._time = float(times[-1])
        return outputs


class FrictionBench(_Bench):
    """A friction FMU whose joints move independently from `positions` (n,) [rad]."""

    def __init__(self, instance: FmuInstance) -> None:
        names: set[str] = {variable.name for variable in instance.description.modelVariables}
        joint_count = sum(name.startswith("tau[") for name in names)
        vector_names = [quantity.name for quantity in INPUTS]
        for name in ("tau[1]", *_name_elements(vector_names, max(joint_count, 1))):
            if name not in names:
                raise SimulationError(
                    f"{instance.fmu}: not a friction FMU: '{name}' is missing; it needs the "
                    "inputs dq[i], q[i], tau_load[i] and the outputs tau[i]."
                )
        super().__init__(instance, joint_count, vector_names, ["tau"])
        self.positions = np.zeros(joint_count)
        self.exact = DISCRETISATION in names  # integrates exactly over any step
        self._has_start_mode = START_MODE in names
        # Time of steady sliding [s].
        self.sliding_time = _EXACT_SLIDING_TIME if self.exact else _SLIDING_TIME

    def start(
        self,
        *,
        load: float | Array,
        exact: bool = True,
        dq: Array | None = None,
        unmoved: bool = False,
    ) -> Array:
        """Restart at rest or at `dq` (n,) [rad/s]; return the torque (n,) [N.m].

        In motion friction starts in its steady state if the FMU has one, except with `unmoved`.
        `exact` overrides the discretisation of the law.
        """
        start_values = {}
        if exact and self.exact:
            start_values[DISCRETISATION] = _EXACT
        if unmoved and self._has_start_mode:
            start_values[START_MODE] = GIVEN
        self._rows[0] = 0.0 if dq is None else dq
        self._rows[1] = self.positions
        self._rows[2] = load
        self._start(start_values)
        return self._outputs.read().copy()

    def step(self, dt: float, dq: Array, q: Array) -> Array:
        """Hold dq (n,) [rad/s] at q (n,) [rad]; return the torque (n,), valid for one step."""
        self._rows[:2] = dq, q
        return self._step(dt)

    def move(
        self, dt: Array, dq: Array, q: Array | None = None, load: Array | None = None
    ) -> Array:
        """Hold `dq` (K, n) [rad/s] for `dt` (K,) [s]; return the torque at each end (K, n) [N.m].

        The position `q` (K, n) [rad] is constant by default.
        """
        if q is None:
            q = np.broadcast_to(self.positions, dq.shape)
        if load is None:
            load = np.broadcast_to(self._rows[2], dq.shape)
        substeps = np.ones(len(dt), dtype=int)
        if not self.exact:
            substeps = np.maximum(np.ceil(dt / _MAX_SUBSTEP).astype(int), 1)
        rows = np.repeat(np.hstack([dq, q, load]), substeps, axis=0)
        torque = self._hold_rows(np.repeat(dt / substeps, substeps), rows)
        last_substeps = np.cumsum(substeps) - 1
        return np.asarray(torque[last_substeps])


class DriveBench(_Bench):
    """A JointDrive with motor torque, and a link for joints with a spring."""

    def __init__(self, instance: FmuInstance, positions: Array) -> None:
        self.positions = positions
        inputs = ("tau_motor", "q_link", "dq_link", "tau_load")
        super().__init__(instance, len(positions), inputs, ("q", "dq", "tau_f"))
        self.torque = self._rows[0]  # motor torque (n,) [N.m], set in place

    def start(
        self,
        *,
        load: float | Array,
        torque: Array,
        stiffness: Array | None = None,
        substep: float | None = None,
    ) -> None:
        """Restart at rest under a motor torque (n,) [N.m], the link at the joint's position.

        `stiffness` (n,) is that of the flexsplines [N.m/rad], `substep` the longest inner step [s].
        """
        vectors = {"q_start": self.positions, "stiffness": stiffness}
        start_values: dict[str, Value] = {
            name: tuple(values.tolist()) for name, values in vectors.items() if values is not None
        }
        if substep is not None:
            start_values["substep"] = substep
        self._rows[0] = torque
        self._rows[1] = self.positions
        self._rows[2] = 0.0
        self._rows[3] = load
        self._start(self._instance.variables.expand_values(start_values))

    def step(self, dt: float) -> Array:
        """Step; return q, dq and friction torque (3, n), valid for one step."""
        return self._step(dt).reshape(3, self.joints)

    def run(
        self,
        dt: Array,
        *,
        torque: Array | None = None,
        link: Array | None = None,
        load: Array | None = None,
    ) -> Array:
        """Return q, dq and tau_f (3, K, n) over steps `dt` (K,) [s].

        Motor torque [N.m], link position [rad] and load [N.m] are (K, n); unchanged if None.
        """
        rows = np.tile(self._rows, (len(dt), 1, 1))
        for row, values in enumerate((torque, link, None, load)):
            if values is not None:
                rows[:, row] = values
        outputs = self._hold_rows(dt, rows.reshape(len(dt), -1))
        return np.moveaxis(outputs.reshape(len(dt), 3, self.joints), 1, 0)
