"""A C header of a law, compiled for this machine and called through ctypes."""

import ctypes
from ctypes import POINTER, c_bool, c_double, c_size_t
from pathlib import Path

import numpy as np

from fmu_src.export.toolchain import TARGETS, build
from hesr.extras.one_file.c_header import export_c
from hesr_model.friction.model import FrictionModel

LIBRARY = """
#include "law.h"
#define EXPORT __attribute__((visibility("default")))
EXPORT size_t size(void) { return sizeof(law_state); }
EXPORT void init(law_state *s) { law_init(s); }
EXPORT void begin(law_state *s, const double *dq, const double *q, const double *load) {
    law_begin(s, dq, q, load); }
EXPORT bool step(law_state *s, const double *dq, const double *q, const double *load, double dt,
                 double *tau) { return law_step(s, dq, q, load, dt, tau); }
EXPORT size_t batch(law_state *s, size_t n, const double *dq, const double *q, const double *load,
                    double dt, double *tau) { return law_batch(s, n, dq, q, load, dt, tau); }
EXPORT size_t states(void) { return LAW_STATES; }
"""
SIDE_BY_SIDE = """
EXPORT size_t side_by_side(size_t n, double *x, const double *dq, const double *q,
                           const double *load, double dt, double *tau) {
    return law_side_by_side(law_coefficients, n, x, dq, q, load, dt, tau); }
"""


class CompiledHeader:
    """A header compiled for this machine."""

    def __init__(self, model: FrictionModel, folder: Path) -> None:
        export_c(model, folder / "law.h")
        euler = any(law.discretisation == "euler" for law in model.laws)
        (folder / "law.c").write_text(LIBRARY + ("" if euler else SIDE_BY_SIDE), encoding="utf-8")
        file = folder / "law.so"
        file.write_bytes(build(folder / "law.c", "law", TARGETS["linux64"]))
        self._library = ctypes.CDLL(str(file))
        self._library.size.restype = self._library.batch.restype = c_size_t
        self._library.step.restype = c_bool
        self.joints = len(model.joints)

    def state(self, robots: int = 1):
        size = self._library.size()
        state = (ctypes.c_char * (size * robots))()
        for i in range(robots):
            self._library.init(ctypes.byref(state, i * size))
        return state

    def begin(self, state, dq, q, load) -> None:
        self._library.begin(state, *map(_pointer, (dq, q, load)))

    def step(self, state, dq, q, load, dt: float) -> np.ndarray | None:
        tau = np.full(self.joints, np.nan)
        moved = self._library.step(
            state, *map(_pointer, (dq, q, load)), c_double(dt), _pointer(tau)
        )
        return tau if moved else None

    def batch(self, state, dq, q, load, dt: float) -> tuple[int, np.ndarray]:
        tau = np.full(dq.shape, np.nan)
        rows = map(_pointer, (dq, q, load))
        count = self._library.batch(state, c_size_t(len(dq)), *rows, c_double(dt), _pointer(tau))
        return count, tau

    def side_by_side(self, x, dq, q, load, dt: float) -> tuple[int, np.ndarray]:
        """Step robots stored in columns; x changes."""
        tau = np.full(dq.shape, np.nan)
        function = self._library.side_by_side
        function.restype = c_size_t
        rows = [np.ascontiguousarray(row) for row in (dq, q, load)]
        count = function(
            c_size_t(dq.shape[1]), _pointer(x), *map(_pointer, rows), c_double(dt), _pointer(tau)
        )
        return count, tau

    def start(self, robots: int) -> np.ndarray:
        """Initial states of robots (states, robots)."""
        state = bytes(self.state())[-8 * max(self._library.states(), 1) :]
        x = np.frombuffer(state)[: self._library.states(), None]
        return np.ascontiguousarray(np.repeat(x, robots, axis=1))


def _pointer(values: np.ndarray):
    return np.ascontiguousarray(values).ctypes.data_as(POINTER(c_double))
