"""The types of the arrays that every room hands to the next."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Range = tuple[float, float]
"""The least and the greatest value of something."""
