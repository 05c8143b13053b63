# SPDX-License-Identifier: Apache-2.0
"""One offline HTML page of results: what a folder holds becomes tables and charts; `viewer/` has the scripts."""
