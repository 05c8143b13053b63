# SPDX-License-Identifier: Apache-2.0
"""Data association of features with map landmarks: associators by name, `backend.association`.

gated                 geometry first: the nearest descriptor inside the gate of the predicted observation
classification        the nearest descriptor class by Mahalanobis distance
gated_classification  the same inside the gate
nn                    the nearest descriptor, without a gate
ransac, gtm, hgtm     nn with outlier rejection by a homography, by neighbourhood graphs, by shapes of triangles
gated_ransac, ...     gated with the same outlier rejection
cds                   the nearest descriptor, for a few features spread over the image
coarse_fine           the nearest descriptors, a fixed number of the best
"""

from uav_vslam.association.classification import classify, classify_gated
from uav_vslam.association.guided import gated
from uav_vslam.association.hgtm import same_shapes
from uav_vslam.association.in_view import Associator, InView
from uav_vslam.association.nearest import cds, coarse_fine, nn
from uav_vslam.association.outlier_rejection import InlierSelection, with_outlier_rejection
from uav_vslam.vision.matching.gtm import same_neighbours
from uav_vslam.vision.matching.ransac import same_homography

__all__ = ["ASSOCIATORS", "Associator", "InView"]

OUTLIER_REJECTION: dict[str, InlierSelection] = {"ransac": same_homography, "gtm": same_neighbours, "hgtm": same_shapes}

ASSOCIATORS: dict[str, Associator] = {
    "gated": gated,
    "gated_classification": classify_gated,
    "classification": classify,
    "nn": nn,
    **{name: with_outlier_rejection(nn, inliers) for name, inliers in OUTLIER_REJECTION.items()},
    **{f"gated_{name}": with_outlier_rejection(gated, inliers) for name, inliers in OUTLIER_REJECTION.items()},
    "cds": cds,
    "coarse_fine": coarse_fine,
}
