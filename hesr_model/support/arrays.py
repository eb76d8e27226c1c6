"""Types of arrays, by what they hold; shapes and units stand with whatever has one."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Numbers."""
Mask = NDArray[np.bool_]
"""Which rows, or which of whatever else."""
Integers = NDArray[np.int_]
"""Labels, counts and places."""
