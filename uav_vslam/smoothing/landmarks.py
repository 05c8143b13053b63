# SPDX-License-Identifier: Apache-2.0
"""A saved map with the landmarks where the smoothed flight has them.

In the notation of `views`, a point's error is L^-T (n - sum E' d(pose) - F' d(rig) - T' d(landmark)) with n white:
noise of its own, and a linear function of states and border, whose joint covariance is known. So the points of a
section have an exact joint covariance, which is bounded as the filter's is.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.slam.saved_map import Mapped, MappedPlace
from uav_vslam.smoothing.arrowhead import Factor, Marginals, covariance_of
from uav_vslam.smoothing.layout import Layout
from uav_vslam.smoothing.sightings import Rows, Sightings
from uav_vslam.smoothing.views import Eliminated

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointErrors:
    """What the errors of a flight's points depend on.

    Attributes:
        sightings: of the points, as they were eliminated.
        batches: rows of points, and those points eliminated.
        layout, factor, marginals: of the normal equations of the rest.
    """

    sightings: Sightings
    batches: Sequence[tuple[slice, Eliminated]]
    layout: Layout
    factor: Factor
    marginals: Marginals

    def covariance(self, points: Rows) -> Array:
        """Return the (3N, 3N) covariance of the positions of N > 0 points, in rising order [m^2]."""
        chosen = np.isin(self.sightings.points, points)
        blocks = self.sightings.states[chosen] // self.layout.size
        first, last = int(blocks.min()), int(blocks.max())
        of_blocks = np.zeros((last + 1 - first, len(points), 3, self.layout.size, self.layout.stride))
        of_border = np.zeros((len(points), 3, self.layout.border))
        own = np.zeros((len(points), 3, len(points), 3))
        for rows, part in self.batches:
            wanted = np.flatnonzero((points >= rows.start) & (points < rows.stop))
            for k, point in zip(wanted.tolist(), (points[wanted] - rows.start).tolist(), strict=True):
                to_position = part.L_inverse[point].T[:3]
                own[k, :, k] = to_position @ to_position.T
                of_border[k, :, : self.layout.rig] = to_position @ part.F[point].T
                revisited = int(self.sightings.landmarks[points[k]])
                if revisited >= 0:
                    of_border[k, :, self.layout.landmark(revisited)] = to_position @ part.tie[point].T
                seen = part.points == point
                block, row = np.divmod(part.states[seen], self.layout.size)
                for b, r, E in zip(block.tolist(), row.tolist(), part.E[seen], strict=True):
                    of_blocks[b - first, k, :, r, self.layout.seen] += (to_position @ E.T).T
        flat = of_blocks.reshape(len(of_blocks), 3 * len(points), -1)
        of_rest = covariance_of(self.factor, self.marginals, first, flat, of_border.reshape(3 * len(points), -1))
        return own.reshape(of_rest.shape) + of_rest


def smoothed_landmarks(mapped: Mapped, positions: Array, errors: PointErrors, *, stamp_ns: int) -> Mapped:
    """Return the landmarks of the same flight at the smoothed points that show them.

    Of several points that show a landmark, the one with most observations stands for it. Landmarks that no point shows,
    because its track was refused, are left out.

    Args:
        mapped: by the filter.
        positions: (P, 3) of all points [m].
        errors: of the points.
        stamp_ns: of the last measurement [ns].
    """
    points_of = _points_of(errors.sightings)
    places = []
    for place in mapped.places:
        points = np.array([points_of.get(i, -1) for i in place.ids.tolist()], np.intp)
        rows = np.flatnonzero(points >= 0)
        rows = rows[np.argsort(points[rows])]
        if len(rows) == 0:
            continue
        places.append(
            MappedPlace.of(
                place.ids[rows],
                positions[points[rows]],
                errors.covariance(points[rows]),
                descriptors=place.descriptors[rows],
                observations=place.observations[rows],
            )
        )
    return Mapped(dataclasses.replace(mapped.origin, stamp_ns=stamp_ns), tuple(places))


def _points_of(sightings: Sightings) -> dict[int, int]:
    """Return the row of the point that shows each landmark, by its identifier."""
    observations = np.bincount(sightings.points, minlength=len(sightings.ids))
    rising = np.argsort(observations, kind="stable")
    rising = rising[sightings.ids[rising] > 0]
    return dict(zip(sightings.ids[rising].tolist(), rising.tolist(), strict=True))
