# SPDX-License-Identifier: Apache-2.0
"""State models, filters, covariance intersection and consistency: pure linear algebra on manifolds."""
