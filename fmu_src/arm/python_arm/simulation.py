"""Simulation of a model by MuJoCo's Python package, equal to that of the native FMU in C."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, fields
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from fmu_src.arm.losses import age_function, level_function
from fmu_src.arm.table import (
    LATENCY,
    PAYLOAD,
    SCALE,
    SEED,
    ArmSignals,
    Loss,
    join_seed_halves,
    noise_name,
    variables,
)
from hesr_model.errors import SimulationError
from hesr_model.logs.noise import standard_normal
from hesr_model.support.arrays import Array

_MIN_SCALE = 1e-9  # without friction; bristles need a stiffness
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_MAX_MAGNITUDE = 1e10  # beyond it MuJoCo zeroes controls and resets states
_NOISE_BLOCK_SIZE = 256  # noise samples drawn at once
_MIN_LEVEL = 1e-9  # [N.m] MuJoCo has no friction constraint for a joint without friction


class LossState:
    """Levels [N.m] and ages [s] of dry friction, scaled by a factor."""

    def __init__(self, losses: Sequence[Loss], scale: float) -> None:
        self._scale = scale
        rows = np.array([astuple(loss) for loss in losses], dtype=float)
        columns = rows.reshape(len(losses), len(fields(Loss))).T
        self._numbers = {f.name: column for f, column in zip(fields(Loss), columns, strict=True)}
        self._dof = self._numbers["dof"].astype(int)
        self._carrier = np.maximum(self._numbers["carrier"], 0).astype(int)
        self._load = self._numbers["load"] * (self._numbers["carrier"] >= 0)
        self.levels: Array = self._numbers["constant"].copy()
        self.ages: Array = np.zeros(len(losses))

    def start(self, model: Any, data: Any) -> None:
        """Start with new contacts at the evaluated instant."""
        self.ages[:] = 0.0
        self._update(model, data)

    def advance(self, model: Any, data: Any) -> None:
        """Advance by the last step of the simulation."""
        speed = data.qvel[self._dof]
        step_size = float(model.opt.timestep)
        [self.ages] = age_function()(
            speed, self.ages, step_size, self._numbers["slip"], self._numbers["longest"]
        )
        self._update(model, data)

    def _update(self, model: Any, data: Any) -> None:
        columns = self._numbers
        torque = data.qfrc_spring[self._carrier] + data.qfrc_gravcomp[self._carrier]
        speed = data.qvel[self._dof]
        numbers = (
            self._load,
            columns["direct"],
            columns["speed"],
            columns["evolution"],
            columns["age"],
        )
        [self.levels] = level_function()(torque, speed, self.ages, columns["constant"], *numbers)
        self.apply(model)

    def apply(self, model: Any) -> None:
        """Write the levels into a model."""
        model.dof_frictionloss[self._dof] = np.maximum(self._scale * self.levels, _MIN_LEVEL)

    def torque(self, model: Any, data: Any) -> Array:
        """Return the torque against the motion at the evaluated instant [N.m]."""
        dof = self._dof
        return np.asarray(model.dof_damping[dof] * data.qvel[dof] - data.qfrc_constraint[dof])


class Simulation:
    """A compiled model, which does not change, with the variables of its FMUs."""

    _data: mujoco.MjData
    _noise_block: Array
    _first_sample: int

    def __init__(self, signals: ArmSignals) -> None:
        self.signals = signals
        self.variables = variables(signals)
        self.defaults = {
            variable.name: variable.start for variable in self.variables if variable.role == "fixed"
        }
        self._noisy = [k for k, o in enumerate(signals.outputs) if o.noise is not None]
        self._state_size = mujoco.mj_stateSize(signals.model, _STATE)
        drives: list[tuple[int, int]] = []
        for k, arm_input in enumerate(signals.inputs):
            drives += [(control, k) for control in arm_input.controls]
        self._controls, self._driven = np.array(drives, dtype=int).reshape(-1, 2).T
        self._streams = np.array([signals.outputs[k].stream for k in self._noisy])
        self.reset()

    @property
    def timestep(self) -> float:
        """Step of the simulation [s]."""
        return float(self.signals.model.opt.timestep)

    def reset(self, parameters: Mapping[str, float] | None = None) -> Array:
        """Start with these parameters, the others by default, and return the outputs."""
        parameter_values = self.defaults | dict(parameters or {})
        self._check(parameter_values)
        self.parameters = parameter_values
        self.samples = 0
        self._adapt()
        data = self._data
        for start in self.signals.starts:
            data.qpos[start.position] = parameter_values[start.name]
            if start.activation is not None:
                data.act[start.activation] = parameter_values[start.name]
            if start.other is not None:
                data.qpos[start.other] = parameter_values[start.name]
        mujoco.mj_forward(self._model, data)
        acting = data.qfrc_smooth.copy()
        for start in self.signals.starts:
            if start.activation is not None:
                data.act[start.activation] -= acting[list(start.held)].sum() / start.gain
        self._losses.start(self._model, data)
        return self.outputs()

    def step(self, inputs: ArrayLike, dt: float) -> Array:
        """Hold the inputs over `dt` [s], a multiple of `timestep`; return the outputs at its end.

        Raises SimulationError, with the state unchanged, for another `dt`, excessive inputs or
        divergence.
        """
        timestep = self.timestep
        count = round(dt / timestep)
        if count < 1 or abs(dt - count * timestep) > 1e-6 * timestep:
            raise SimulationError(
                f"the step is {dt:g} s; a multiple of the simulation's own, {timestep:g} s, is "
                "needed."
            )
        before = self._state()
        losses = (self._losses.levels, self._losses.ages)
        data = self._data
        values = np.atleast_1d(np.asarray(inputs, dtype=float))
        for arm_input, value in zip(self.signals.inputs, values.tolist(), strict=True):
            if not abs(value) <= _MAX_MAGNITUDE:
                raise SimulationError(
                    f"{arm_input.name} is {value:g}; the largest is {_MAX_MAGNITUDE:g}."
                )
        data.ctrl[self._controls] = values[self._driven]
        with _quiet():
            self._advance(count)
        if self._has_diverged():
            self._data = mujoco.MjData(self._model)
            self._restore(before, *losses)
            raise SimulationError(f"the simulation has diverged within {dt:g} s.")
        self.samples += 1
        return self.outputs()

    def _advance(self, count: int) -> None:
        if not self.signals.losses:
            mujoco.mj_step(self._model, self._data, nstep=count)
            return
        for _ in range(count):
            mujoco.mj_step(self._model, self._data)
            self._losses.advance(self._model, self._data)

    def outputs(self) -> Array:
        """Return the outputs at this instant."""
        data = self._data
        # Reading outputs must not change the initial guess of the contact solver.
        guess = data.qacc_warmstart.copy()
        mujoco.mj_forward(self._model, data)
        data.qacc_warmstart[:] = guess
        outputs: Array = self._weights @ data.sensordata
        if self.signals.losses:
            outputs += self._loss_weights @ self._losses.torque(self._model, data)
        if self._noisy:
            outputs[self._noisy] += self._sigma * self._noise(self.samples)
        return outputs

    def _noise(self, sample: int) -> Array:
        row = sample - self._first_sample
        if not 0 <= row < len(self._noise_block):
            self._first_sample = sample
            counters = np.arange(sample, sample + _NOISE_BLOCK_SIZE)[:, None]
            self._noise_block = standard_normal(self._seed, self._streams, counters)
            row = 0
        return np.asarray(self._noise_block[row])

    def state(self) -> dict[str, Any]:
        """Return the state in a form that JSON can hold."""
        return {
            "parameters": self.parameters,
            "samples": self.samples,
            "state": self._state().tolist(),
            "levels": self._losses.levels.tolist(),
            "ages": self._losses.ages.tolist(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Return to a state."""
        if state["parameters"] != self.parameters:
            self.parameters = dict(state["parameters"])
            self._adapt()
        self.samples = int(state["samples"])
        self._restore(*(np.array(state[key]) for key in ("state", "levels", "ages")))

    def _state(self) -> Array:
        state = np.empty(self._state_size)
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return state

    def _restore(self, state: Array, levels: Array, ages: Array) -> None:
        mujoco.mj_setState(self._model, self._data, state, _STATE)
        self._losses.levels = levels
        self._losses.ages = ages
        self._losses.apply(self._model)

    def _check(self, parameters: Mapping[str, float]) -> None:
        for name, value in parameters.items():
            if name not in self.defaults:
                raise SimulationError(f"there is no parameter '{name}'.")
            if not np.isfinite(value):
                raise SimulationError(f"{name} is {value:g}; a finite number is needed.")
            signed = name.startswith(f"{SEED}[") or name in {s.name for s in self.signals.starts}
            if value < 0 and not signed:
                raise SimulationError(f"{name} is {value:g}; it must not be negative.")
        delay = self.signals.delay
        if delay and parameters[LATENCY] > delay.longest * (1 + 1e-9):
            raise SimulationError(
                f"latency is {parameters[LATENCY]:g} s; the model's buffers hold "
                f"{delay.longest:g} s."
            )

    def _adapt(self) -> None:
        """Build the model and the weights of its sensors for the parameters."""
        parameters = self.parameters
        signals = self.signals
        self._model = model = copy.copy(signals.model)
        scale = parameters.get(SCALE, 1.0)
        element_scale = max(scale, _MIN_SCALE)
        for actuator in signals.friction:
            model.actuator_biasprm[actuator, [0, 3, 4]] *= element_scale
            model.actuator_dynprm[actuator, [5, 6]] *= element_scale
            model.actuator_damping[actuator] *= element_scale
            model.actuator_dampingpoly[actuator] *= element_scale
        model.dof_damping[[loss.dof for loss in signals.losses]] *= scale
        self._losses = LossState(signals.losses, scale)
        if signals.delay is not None:
            for actuator in signals.delay.actuators:
                self._set_latency(actuator, parameters[LATENCY])
        self._data = mujoco.MjData(model)
        if signals.payload is not None:
            model.body_mass[signals.payload] += parameters[PAYLOAD]
            mujoco.mj_setConst(model, self._data)
            mujoco.mj_resetData(model, self._data)
        self._weights = self._weigh_sensors(scale)
        self._loss_weights = np.zeros((len(signals.outputs), len(signals.losses)))
        for row, output in zip(self._loss_weights, signals.outputs, strict=True):
            row[list(output.losses)] = 1.0
        self._sigma = np.array([parameters[noise_name(signals.outputs[k])] for k in self._noisy])
        self._noise_block = np.empty((0, len(self._noisy)))
        self._first_sample = 0
        low = int(parameters.get(f"{SEED}[1]", 0))
        high = int(parameters.get(f"{SEED}[2]", 0))
        self._seed = join_seed_halves(low, high)

    def _set_latency(self, actuator: int, latency: float) -> None:
        """Delay an actuator; without interpolation by whole steps of the simulation, rounded up."""
        model = self._model
        if model.actuator_history[actuator, 1] > 0:  # interpolated
            model.actuator_delay[actuator] = latency
            return
        step_size = float(model.opt.timestep)
        # Half a step less, so that round-off of sums of steps never adds a step.
        steps = max(np.ceil(latency / step_size - 1e-6) - 0.5, 0.0)
        model.actuator_delay[actuator] = steps * step_size

    def _weigh_sensors(self, scale: float) -> Array:
        """Return the weights (outputs, sensor data) of the outputs, at a friction scale."""
        weights = np.zeros((len(self.signals.outputs), self._model.nsensordata))
        for row, output in zip(weights, self.signals.outputs, strict=True):
            for address, factor, scaled in output.reads:
                if scaled:
                    factor *= scale
                row[address] += factor
        return weights

    def _has_diverged(self) -> bool:
        data = self._data
        first = int(mujoco.mjtWarning.mjWARN_CONTACTFULL)
        extremes = (data.qpos.max(), -data.qpos.min(), data.qvel.max(), -data.qvel.min())
        bounded = all(extreme <= _MAX_MAGNITUDE for extreme in extremes)  # false for NaN
        return not bounded or bool(data.warning.number[first:].any())


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to a file in the working directory."""
    before = cast(Any, mujoco.get_mju_user_warning())
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
