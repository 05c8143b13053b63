# SPDX-License-Identifier: Apache-2.0
"""A connected dominating set dominates and is connected, on graphs of any shape."""

import networkx as nx
import numpy as np
import pytest
from scipy.sparse import csr_array

from uav_vslam.vision.matching.cds import connected_dominating_set, dominating_points, neighbourhood_graph


def adjacency(graph):
    return csr_array(nx.to_numpy_array(graph, dtype=bool))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("density", [0.02, 0.1, 0.5])
def test_each_component_is_dominated_by_a_connected_set(seed, density):
    graph = nx.gnp_random_graph(60, density, seed=seed)
    found = set(connected_dominating_set(adjacency(graph)).tolist())
    assert nx.is_dominating_set(graph, found)
    for component in nx.connected_components(graph):
        assert nx.is_connected(graph.subgraph(found & component))


@pytest.mark.parametrize(
    ("graph", "expected"),
    [(nx.star_graph(9), [0]), (nx.path_graph(5), [1, 2, 3]), (nx.empty_graph(3), [0, 1, 2])],
)
def test_known_graphs(graph, expected):
    assert connected_dominating_set(adjacency(graph)).tolist() == expected


def test_an_empty_graph_has_an_empty_set():
    assert len(connected_dominating_set(neighbourhood_graph(np.zeros((0, 2)), 3))) == 0
    assert connected_dominating_set(neighbourhood_graph(np.zeros((1, 2)), 3)).tolist() == [0]


def test_the_neighbourhood_graph_is_symmetric_without_loops():
    points = np.random.default_rng(1).uniform(0, 100, (50, 2))
    graph = neighbourhood_graph(points, 3).toarray()
    np.testing.assert_array_equal(graph, graph.T)
    assert not graph.diagonal().any()
    assert (graph.sum(axis=1) >= 3).all()
    assert neighbourhood_graph(points[:2], 3).toarray().tolist() == [[False, True], [True, False]]


def test_the_set_is_smaller_and_every_point_is_near_it():
    rng = np.random.default_rng(2)
    pixels = rng.uniform(0, 600, (400, 2)).astype(np.float32)
    rows = dominating_points(pixels)
    assert len(rows) < 0.3 * 400
    distance = np.linalg.norm(pixels[:, None] - pixels[rows], axis=2).min(axis=1)
    spacing = np.sqrt(600**2 / 400)
    assert distance.max() < 4.0 * spacing
