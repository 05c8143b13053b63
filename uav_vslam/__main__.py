# SPDX-License-Identifier: Apache-2.0
"""`python -m uav_vslam`: the `uav-vslam` command of this interpreter, whatever PATH says."""

import sys

from uav_vslam.cli.start import main

if __name__ == "__main__":
    sys.exit(main())
