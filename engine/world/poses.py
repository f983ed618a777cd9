"""Where a fleet is at one time: what is drawn, live and in replay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Poses:
    """The fleet at one time; arrays per vehicle. x and y in metres, heading in degrees ccw from east, soc in [0, 1]."""

    x_m: F32
    y_m: F32
    heading_deg: F32
    soc: F32  # of the latest battery sample
    state: NDArray[np.uint8]  # VehicleState
    task: NDArray[np.uint8]  # Task
    loaded: NDArray[np.uint8]
    low: NDArray[np.uint8]  # below the level at which a free vehicle goes charging
    order: NDArray[np.int32]
    place: NDArray[np.int32]  # the place it is in, or that it leaves
