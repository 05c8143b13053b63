# SPDX-License-Identifier: Apache-2.0
"""Images wait for their poses, which leave the filter's window a second or two later."""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

MAX_WAITING = 60  # images: 3 s at 20 Hz


class WaitingImages:
    """One vehicle's left images, in stamp order, until their poses come.

    Attributes:
        dropped: images that waited for too long, or whose pose was passed over.
    """

    def __init__(self) -> None:
        self._images: OrderedDict[int, NDArray[np.generic]] = OrderedDict()
        self.dropped = 0

    def add(self, stamp_ns: int, pixels: NDArray[np.generic]) -> None:
        """Hold an image, grey or BGR; the oldest one gives way if too many wait."""
        self._images[stamp_ns] = pixels
        if len(self._images) > MAX_WAITING:
            self._images.popitem(last=False)
            self.dropped += 1

    def take(self, stamp_ns: int) -> NDArray[np.generic] | None:
        """Return the image of a pose's stamp; None if it is not there. Older images are given up."""
        while self._images and next(iter(self._images)) < stamp_ns:
            self._images.popitem(last=False)
            self.dropped += 1
        return self._images.pop(stamp_ns, None)
