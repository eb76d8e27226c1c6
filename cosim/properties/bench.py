"""Two benches: one moves the joints of a friction FMU, the other drives those of a JointDrive."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fmu_src.friction.friction_component import GIVEN, START_MODE
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import through
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import INPUTS
from hesr_model.support.arrays import Array

DISCRETISATION = "discretisation"
_EXACT = 1.0
_SUBSTEP = 5e-3  # [s] of FMUs of which it is not known that they bear long steps
_FOREVER, _LONG = 1e4, 60.0  # [s] of steady sliding, with long steps and without


class FrictionBench:
    """A friction FMU whose joints are moved as wanted, all at once, each for itself.

    Parameters
    ----------
    component : the loaded FMU.
    places : (n,) position of each joint where it is at rest [rad]; zero where not given.

    Attributes
    ----------
    joints : how many there are.
    exact : whether the FMU integrates its states exactly over a step of any length on request, as
        ours do.
    forever : how long steady sliding takes [s].

    Raises
    ------
    SimulationError
        If the FMU has not the connectors of a friction FMU.
    """

    def __init__(self, component: FmuInstance, places: Array | None = None) -> None:
        names: set[str] = {v.name for v in component.description.modelVariables}
        self.joints = sum(name.startswith("tau[") for name in names)
        wanted = [f"{u.name}[{i}]" for u in INPUTS for i in range(1, max(self.joints, 1) + 1)]
        for name in ("tau[1]", *wanted):
            if name not in names:
                raise SimulationError(
                    f"{component.fmu}: no friction FMU, since there is no '{name}'; needed are the "
                    "inputs dq[i], q[i], tau_load[i] and the outputs tau[i]."
                )
        self.places = np.zeros(self.joints) if places is None else places
        self.exact = DISCRETISATION in names
        self._settles = START_MODE in names
        self.forever = _FOREVER if self.exact else _LONG
        self._component = component
        self._inputs = component.buffer(wanted)
        self._outputs = component.buffer([f"tau[{i}]" for i in range(1, self.joints + 1)])
        self._time = 0.0

    def start(
        self,
        *,
        load: float | Array,
        exact: bool = True,
        dq: Array | None = None,
        unmoved: bool = False,
    ) -> Array:
        """Begin anew, at rest or at a velocity; return the (n,) torque there.

        In motion friction begins in its steady state, where the FMU knows one.

        Parameters
        ----------
        load : of each joint [N.m], held until the next start.
        exact : integrate exactly, whatever the law's own discretisation, where the FMU can.
        dq : (n,) velocity [rad/s].
        unmoved : begin with the states of rest, whatever the velocity.
        """
        component, n = self._component, self.joints
        if component.used:
            component.reset()
        chosen = {DISCRETISATION: _EXACT} if exact and self.exact else {}
        if unmoved and self._settles:
            chosen[START_MODE] = GIVEN
        self._inputs.values[:n] = 0.0 if dq is None else dq
        self._inputs.values[n : 2 * n] = self.places
        self._inputs.values[2 * n :] = load
        component.initialise(start=chosen, inputs=self._inputs)
        self._time = 0.0
        return self._outputs.read().copy()

    def step(self, dt: float, dq: Array, q: Array, load: Array | None = None) -> Array:
        """Hold velocities dq (n,) [rad/s] at places q (n,) [rad] for a time [s]; return the torque.

        It is (n,) [N.m], good until the next step. A load (n,) [N.m] is that of the start where not
        given.
        """
        n, inputs = self.joints, self._inputs
        inputs.values[:n] = dq
        inputs.values[n : 2 * n] = q
        if load is not None:
            inputs.values[2 * n :] = load
        inputs.write()
        self._component.step(self._time, dt)
        self._time += dt
        return self._outputs.read()

    def move(
        self, dt: Array, dq: Array, q: Array | None = None, load: Array | None = None
    ) -> Array:
        """Hold velocities one after the other.

        Parameters
        ----------
        dt : (K,) how long each is held [s].
        dq : (K, n) [rad/s].
        q : (K, n) position that the FMU is told [rad]; where not given it is told that the joint
            stays at its place, so that what depends on position does not mix in.
        load : (K, n) [N.m]; that of the start where not given.

        Returns
        -------
        (K, n) torque at the end of each [N.m].
        """
        n = self.joints
        told = np.broadcast_to(self.places, dq.shape) if q is None else q
        held = np.broadcast_to(self._inputs.values[2 * n :], dq.shape) if load is None else load
        parts = np.ones(len(dt), dtype=int)
        if not self.exact:
            parts = np.maximum(np.ceil(dt / _SUBSTEP).astype(int), 1)
        sizes = np.repeat(dt / parts, parts)
        times = np.cumsum(np.concatenate([[self._time], sizes]))
        rows = np.repeat(np.hstack([dq, told, held]), parts, axis=0)
        tau = through(self._component, self._inputs, self._outputs, times[:-1], sizes, rows)
        self._inputs.values[:] = rows[-1]
        self._time = float(times[-1])
        return np.asarray(tau[np.cumsum(parts) - 1])


@contextmanager
def friction_bench(fmu: Path, places: Array | None = None) -> Iterator[FrictionBench]:
    """Load a friction FMU onto a bench, its joints at places (n,) [rad] where not told."""
    with FmuInstance(fmu) as component:
        yield FrictionBench(component, places)


class DriveBench:
    """A JointDrive whose joints get motor torque, and a link where they have a spring.

    Parameters
    ----------
    component : the loaded FMU.
    places : (n,) where the joints start [rad].
    """

    def __init__(self, component: FmuInstance, places: Array) -> None:
        self.joints = n = len(places)
        self.places = places
        self._component = component
        names = ("tau_motor", "q_link", "dq_link", "tau_load")
        self._inputs = component.buffer([f"{x}[{i}]" for x in names for i in range(1, n + 1)])
        self._outputs = component.buffer(
            [f"{x}[{i}]" for x in ("q", "dq", "tau_f") for i in range(1, n + 1)]
        )
        self._time = 0.0

    def start(
        self,
        *,
        load: float | Array,
        torque: Array,
        stiffness: Array | None = None,
        substep: float | None = None,
    ) -> None:
        """Begin at rest under a torque (n,) [N.m], the link where the joint is.

        The load is that of every joint [N.m], the stiffness (n,) that of its flexspline [N.m/rad],
        the substep the longest inner step [s], the FMU's own where not given.
        """
        component, n = self._component, self.joints
        if component.used:
            component.reset()
        start = {
            f"{name}[{i}]": float(values[i - 1])
            for name, values in (("q_start", self.places), ("stiffness", stiffness))
            if values is not None
            for i in range(1, n + 1)
        }
        if substep is not None:
            start["substep"] = substep
        self._inputs.values[:] = 0.0
        self._inputs.values[:n] = torque
        self._inputs.values[n : 2 * n] = self.places
        self._inputs.values[3 * n :] = load
        component.initialise(start=start, inputs=self._inputs)
        self._time = 0.0

    def step(self, dt: float) -> Array:
        """Go on; return q, dq and friction torque, (3, n) in SI units, good until the next step."""
        self._inputs.write()
        self._component.step(self._time, dt)
        self._time += dt
        return self._outputs.read().reshape(3, self.joints)

    @property
    def torque(self) -> Array:
        """(n,) motor torque [N.m], to be set in place."""
        return self._inputs.values[: self.joints]

    def run(
        self,
        dt: Array,
        *,
        torque: Array | None = None,
        link: Array | None = None,
        load: Array | None = None,
    ) -> Array:
        """Return q, dq and tau_f over steps, (3, K, n) in SI units.

        Parameters
        ----------
        dt : (K,) how long they are [s].
        torque, link, load : (K, n) motor torque [N.m], position of the link [rad] and load [N.m]
            of each; what is not given stays as it is.
        """
        n = self.joints
        rows = np.tile(self._inputs.values, (len(dt), 1))
        for values, first in ((torque, 0), (link, n), (load, 3 * n)):
            if values is not None:
                rows[:, first : first + n] = values
        times = np.cumsum(np.concatenate([[self._time], dt]))
        found = through(self._component, self._inputs, self._outputs, times[:-1], dt, rows)
        self._inputs.values[:] = rows[-1]
        self._time = float(times[-1])
        return np.moveaxis(found.reshape(len(dt), 3, n), 1, 0)


@contextmanager
def drive_bench(fmu: Path, places: Array) -> Iterator[DriveBench]:
    """Load a JointDrive onto a bench, its joints at places (n,) [rad]."""
    with FmuInstance(fmu) as component:
        yield DriveBench(component, places)
