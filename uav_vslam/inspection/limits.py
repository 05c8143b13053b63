# SPDX-License-Identifier: Apache-2.0
"""What the checks allow, and why. Limits that the graph itself applies are imported from where it applies them."""

import math

# Time
MISSING_PERIODS = 1.5  # an interval longer than so many periods lacks a message
LOST_SHARE = 0.01  # of a stream's messages: fewer are lost by any driver now and then
UNUSABLE_SHARE = 0.5  # if more of a stream is useless, so is the stream
STUCK_SHARE = 0.9  # the same of stamps that repeat the one before: half do if each message was recorded twice
MAX_IMAGE_RATE_HZ = 2000.0  # of any stereo camera on a vehicle; a higher mean rate shows stamps in another unit
OWN_CLOCK_S = 1.0  # drivers and recorders delay messages by less, so a larger difference is another clock
UNPAIRED_SHARE = 0.02  # of the images of the camera that has more: a few at both ends have no partner

# IMU
GRAVITY_SHARE = 0.8, 1.25  # median specific force over gravity: a bank of 37 degrees is 1.25
UNITS = {  # what specific force over gravity is in other units
    "in g, not in m/s^2": 1.0 / 9.80665,
    "in mg, not in m/s^2": 1000.0 / 9.80665,
    "in ft/s^2, not in m/s^2": 1.0 / 0.3048,
}
UNIT_SPREAD = 0.2  # relative, around such a factor: bias and manoeuvres
NO_GRAVITY_SHARE = 0.05  # of gravity: less is acceleration from which gravity was removed
NO_GRAVITY_STEADY = 0.5  # mean vector over median size: less, and what is too small for gravity has no direction either
TILT_DEG = 30.0  # between measured and expected direction of gravity: accelerations of 6 m/s^2
MEAN_TILT_DEG = 10.0  # the same over a whole flight with truth, where accelerations are known
LARGEST_RATE = math.radians(2000.0)  # [rad/s] largest range of usual gyroscopes
MEAN_RATE = math.radians(300.0)  # [rad/s] rms: faster an aircraft turns only in aerobatics
TURNS = 0.05  # [rad/s] mean rate, beyond the bias of usual gyroscopes: the body turns
REST_WINDOW_S = 1.0  # rest is looked for in windows of this length
EXTREME_LEVELS = 50  # distinct levels of a signal; with fewer, quantisation repeats the extremes as well
EXTREME_COUNT = 3  # readings at exactly the largest value
EXTREME_RATIO = 3.0  # over the count at the next largest values

# Rotation of the gyroscope against a reference: truth or cameras
ROTATION_MISFIT = 0.35  # rms difference over rms rate: bias, noise and a few degrees of mounting leave less
ROTATION_DETECTED = 5.0  # rms rate over its expected error; below, the vehicle turned too little to judge
REFERENCE_SIGMA_DEG = 0.1  # attitude noise of truth, and of the rotation between two images

# Cameras
FIELD_OF_VIEW_DEG = 10.0, 150.0  # of a pinhole camera, full width
FISHEYE_FIELD_DEG = 10.0, 200.0
PIXEL_ASPECT = 0.8, 1.25  # fx / fy; pixels of usual sensors are square
CENTRE_SHARE = 0.25, 0.75  # principal point over image size
BASELINE_M = 0.01, 5.0  # between finger's breadth and wing span; in millimetres it is 1000 times more
BASELINE_SHARE = 0.02  # between the baselines of two sources; a nominal one is within 1 % of the calibrated one
VIEW_ANGLE_DEG = 45.0  # between the optical axes: beyond it, views of usual lenses do not overlap
ALONG_AXIS_SHARE = 0.7  # of the baseline along the optical axis: such cameras stand behind each other
MIN_MATCHES = 30  # stereo matches over all sampled pairs; fewer say nothing about the geometry
# Of the matches inside the configured depths: 0.99 and more in rooms. A street with a room's 30 m has 0.65, and twice
# the error that it has with all.
DEPTH_SHARE = 0.9
MOVING_PX = 5.0  # between two pairs: far beyond the noise of a match
STILL_PX = 1.0
STILL_SHARE = 0.02  # of such points: 0 or 1 of 300 to 1500 on 14 flights, with a projector's dots 5 to 17 %
STEP_SIGMA_SHARE = 0.2  # of a step's length: cameras that know it less well can't judge its scale
MIN_STEPS = 3  # in the median
SCALE = 0.8, 1.25  # distance flown by stereo over that of the truth
BLIND_SHARE = 0.25  # of the sampled images without contrast
REPEATED_SHARE = 0.02  # of the images equal to the one before

# Start and truth
LARGEST_SPEED = 150.0  # [m/s] of an UAV
START_SIGMAS = 5.0  # of the start's own, by which its velocity may differ from the truth's
START_DISTANCE = 1.0  # [m] in addition: the way between the stamps of start and truth
START_TURN_DEG = 2.0  # in addition
START_VELOCITY = 0.5  # [m/s] in addition: the truth's velocity may be a difference of positions
