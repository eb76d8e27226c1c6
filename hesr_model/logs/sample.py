"""A bounded sample of motions that keeps rare conditions.

Windows of a second belong to strata of each joint: rest, reversals, octaves of speed and of torque.
A stratum ranks them by weighted sampling without replacement (Efraimidis and Spirakis, Inf.
Process. Lett. 97 (2006) 181-185). Strata take turns at choosing their best window, the smallest
first.
"""

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, groupby, pairwise

import numpy as np

from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.signals import Motion, near_reversals
from hesr_model.support.arrays import Array, join_records

Stratum = tuple[int, str, int]  # joint, kind of condition, and octave
WINDOW = 1.0  # length [s]; friction forgets its initial state
_MAX_SPEED_OCTAVE = 8  # octaves of speed above rest; the last one is open
_MIN_TORQUE_OCTAVE = -3
_MAX_TORQUE_OCTAVE = 5  # octaves of torque around the first root mean square


@dataclass(frozen=True, eq=False)
class _Window:
    number: int
    part: int
    motion: Motion
    row_counts: dict[Stratum, int]
    uniform_draw: float


class MotionSample:
    """A sample of at most `max_rows` rows, by `seed` and order."""

    def __init__(self, max_rows: int, seed: int) -> None:
        self._max_rows = max_rows
        self._seed = seed
        self._windows: list[_Window] = []
        self._stratum_rows: Counter[Stratum] = Counter()
        self._numbers = count()
        self._parts = count()
        self._torque_scales: Array | None = None
        self._resting_speeds = np.empty(0)

    def add(self, motion: Motion, *, is_continuation: bool = False) -> None:
        """Offer a log, or a part between gaps, or rows that follow the last ones without a gap."""
        if self._torque_scales is None:
            self._torque_scales = np.maximum(np.sqrt(np.mean(motion.tau**2, axis=0)), 1e-12)
            self._resting_speeds = find_resting_speeds([motion.t], [motion.q_raw], [motion.dq])
        part = self._windows[-1].part if is_continuation and self._windows else next(self._parts)
        for window, row_counts in self._cut(motion):
            self._stratum_rows.update(row_counts)
            uniform_draw = _uniform(self._seed, motion.name, window.t[0])
            self._windows.append(
                _Window(next(self._numbers), part, window, row_counts, uniform_draw)
            )
        self._shrink()

    def motions(self) -> list[Motion]:
        """Return the kept motions in order; adjacent windows are joined."""

        def find_run(entry: tuple[int, _Window]) -> tuple[int, int]:
            # Successive numbers less their places in the list are equal.
            place, window = entry
            return window.part, window.number - place

        motions = []
        for _, run in groupby(enumerate(self._windows), find_run):
            motions.append(join_records([window.motion for _, window in run]))
        return motions

    def _cut(self, motion: Motion) -> Iterator[tuple[Motion, dict[Stratum, int]]]:
        t = motion.t
        joint_count = motion.q.shape[1]
        window_numbers = np.floor((t - t[0]) / WINDOW).astype(int)
        window_numbers = np.minimum(window_numbers, max(int((t[-1] - t[0]) / WINDOW) - 1, 0))
        resting_speeds = self._resting_speeds
        is_near = np.column_stack(
            [
                near_reversals(t, dq, resting_speed)
                for dq, resting_speed in zip(motion.dq.T, resting_speeds.tolist(), strict=True)
            ]
        )
        speed_ratios = np.abs(motion.dq) / resting_speeds
        speed_octaves = np.floor(np.log2(np.maximum(speed_ratios, 1e-12)))
        speed_octaves = np.clip(speed_octaves, -1, _MAX_SPEED_OCTAVE).astype(int)  # -1 is rest
        relative_torque = np.maximum(np.abs(motion.tau), 1e-12) / self._torque_scales
        magnitude_octaves = (
            np.clip(np.floor(np.log2(relative_torque)), _MIN_TORQUE_OCTAVE, _MAX_TORQUE_OCTAVE)
            - _MIN_TORQUE_OCTAVE
            + 1
        )
        torque_octaves = (np.sign(motion.tau) * magnitude_octaves).astype(int)
        ends = [0, *(np.flatnonzero(np.diff(window_numbers)) + 1).tolist(), len(t)]
        for first, last in pairwise(ends):
            row_counts: dict[Stratum, int] = {}
            for j in range(joint_count):
                for condition, codes in (
                    ("speed", speed_octaves),
                    ("torque", torque_octaves),
                    ("near", is_near),
                ):
                    code_counts = np.unique(codes[first:last, j], return_counts=True)
                    for code, row_count in zip(*code_counts, strict=True):
                        if condition != "near" or code:
                            row_counts[j, condition, int(code)] = int(row_count)
            # A view would keep the whole log in memory.
            yield join_records([motion.rows(slice(first, last))]), row_counts

    def _shrink(self) -> None:
        if sum(len(window.motion.t) for window in self._windows) <= self._max_rows:
            return
        # The rarest strata choose first.
        strata = sorted(
            self._stratum_rows, key=lambda stratum: (self._stratum_rows[stratum], stratum)
        )
        queues = {stratum: iter(self._queue_windows(stratum)) for stratum in strata}
        chosen_windows: dict[int, _Window] = {}
        rows_left = self._max_rows
        while queues:
            for stratum, queue in list(queues.items()):
                window = next(
                    (window for window in queue if window.number not in chosen_windows), None
                )
                if window is None:
                    del queues[stratum]
                    continue
                rows_left -= len(window.motion.t)
                if rows_left < 0 and chosen_windows:
                    queues.clear()
                    break
                chosen_windows[window.number] = window
        self._windows = [window for window in self._windows if window.number in chosen_windows]

    def _queue_windows(self, stratum: Stratum) -> list[_Window]:
        """Return the windows of a stratum, the smallest -log(u) / weight first."""

        def compute_order(window: _Window) -> tuple[float, int]:
            return -np.log(window.uniform_draw) / window.row_counts[stratum], window.number

        windows = [window for window in self._windows if stratum in window.row_counts]
        return sorted(windows, key=compute_order)


def _uniform(seed: int, log_name: str, t: float) -> float:
    digest = hashlib.sha256(f"{seed} {log_name} {float(t)!r}".encode()).digest()
    return (int.from_bytes(digest[:6], "big") + 0.5) / 2.0**48
