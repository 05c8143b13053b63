# SPDX-License-Identifier: Apache-2.0
"""Calibration of a stereo rig from pictures of a chessboard or ChArUco board, section 3.3.2 of [thesis].

pictures     image pairs of files or a recording
boards       corners of a board in an image
bundle       least squares over the rig and the poses of the board
solve        cameras and their relative pose from corners
procedure    boards of all pairs, outliers, comparison of halves
files        calibration files of ROS and Kalibr
summary      content of summary.json
"""
