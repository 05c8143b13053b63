# SPDX-License-Identifier: Apache-2.0
"""Which observed feature is which landmark of the map: associators by name, `backend.association`.

gated                 geometry first: inside the gate of what is expected, the nearest descriptor
classification        the nearest class of looks, in Mahalanobis' distance
gated_classification  the same inside the gate
nn                    the nearest descriptor, wherever it lies
ransac, gtm, hgtm     the same, cleaned up by one homography, by who is whose neighbour, by the shapes of triangles
gated_ransac, ...     what `gated` finds, cleaned up in these ways
cds                   the nearest descriptor, of few features that are spread over the image
coarse_fine           the nearest descriptors, a fixed number of the best
"""

from uav_vslam.association.classification import classify, classify_gated
from uav_vslam.association.cleaned import CleanUp, cleaned
from uav_vslam.association.guided import gated
from uav_vslam.association.hgtm import same_shapes
from uav_vslam.association.in_view import Associator, InView
from uav_vslam.association.nearest import cds, coarse_fine, nn
from uav_vslam.vision.matching.gtm import same_neighbours
from uav_vslam.vision.matching.ransac import same_homography

__all__ = ["ASSOCIATORS", "Associator", "InView"]

CLEAN_UPS: dict[str, CleanUp] = {"ransac": same_homography, "gtm": same_neighbours, "hgtm": same_shapes}

ASSOCIATORS: dict[str, Associator] = {
    "gated": gated,
    "gated_classification": classify_gated,
    "classification": classify,
    "nn": nn,
    **{name: cleaned(nn, keep) for name, keep in CLEAN_UPS.items()},
    **{f"gated_{name}": cleaned(gated, keep) for name, keep in CLEAN_UPS.items()},
    "cds": cds,
    "coarse_fine": coarse_fine,
}
