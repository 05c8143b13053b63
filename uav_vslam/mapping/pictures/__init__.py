# SPDX-License-Identifier: Apache-2.0
"""Poses of plain pictures, without SLAM: structure from motion for folders of aerial pictures.

picture      one picture's file, size and metadata
exif         focal length, time and GPS of a file's EXIF data
reading      a folder's pictures in the order of time, and the table of positions beside them
features     SIFT points of downscaled pictures
retrieval    which pictures look alike, by VLAD
pairs        candidates for matching, and matching with a geometric check
loops        pairs that contradict stronger ones around a loop of pictures
layout       a dozen pictures laid out flat, from which everything starts
tracks       one ground point in many pictures
lens         focal length, principal point and radial distortion of pictures from one camera
bundle       least squares over poses, points and lenses
triangulation  points from the rays of known cameras
resection    a picture's pose from known points
growth       from a dozen pictures to all
procedure    adjustment in rounds: outliers out, lost pictures in
gps_positions  where the pictures were taken by GPS, in metres
robust_fits  a plane through points and a similarity between points, in spite of outliers
placement    the result's frame: levelled by the ground, scaled and placed by GPS if that agrees
agreement    which pairs the result brings together, and where it is torn
rigidity     groups of pictures whose sizes relative to each other nothing tells
surface      height of the ground from the points
densification  all matched points, triangulated from the adjusted poses
raw_values   which values of 16-bit images are black and white
views        undistorted images with their poses, as all mapping takes them
overlap      how many pictures see each place
reconstruction  from matched pairs to poses, surface and warnings
drawing      the orthomosaic and its files
chain        the thesis's chain of homographies, as a baseline
output       tables of poses, cameras and figures of quality
"""
