"""The type of arrays of doubles."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
