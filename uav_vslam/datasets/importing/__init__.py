# SPDX-License-Identifier: Apache-2.0
"""Data sets that are no bags, as recordings in our conventional form with a configuration to run them.

problems    what is left out, with file and line
tables      text files of numbers
pictures    image files, their stamps and pairs
motion      ground truth, and the start state taken from it
rigs, axes, columns    calibration, directions and columns as layouts give them
source      what every format yields, and how it is written
euroc, kitti, tumvi, kagaru    the formats
"""
