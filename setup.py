# SPDX-License-Identifier: Apache-2.0
"""The ament_python build of uav_vslam: run by colcon, which `make setup` calls."""

from glob import glob

from setuptools import find_packages, setup

package_name = "uav_vslam"

setup(
    name=package_name,
    version="0.1.0",
    description="Cooperative stereo-inertial SLAM for several UAVs without GPS and without a server.",
    license="Apache-2.0",
    packages=find_packages(include=["uav_vslam", "uav_vslam.*"]),
    package_data={"uav_vslam.vision": ["data/*.npz"], "uav_vslam.report.page": ["assets/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", sorted(glob("config/*.yaml") + glob("config/*.xml"))),
        (f"share/{package_name}/config/import", sorted(glob("config/import/*.yaml"))),
        (f"share/{package_name}/config/links", sorted(glob("config/links/*.yaml"))),
        (f"share/{package_name}/config/dds", sorted(glob("config/dds/*.xml"))),
        (f"share/{package_name}/rviz", ["config/rviz/uav_vslam.rviz"]),
        (f"share/{package_name}/foxglove", ["config/foxglove/uav_vslam.json"]),
        (f"share/{package_name}/launch", sorted(glob("launch/*.launch.py"))),
        # The nodes belong in lib/uav_vslam, where `ros2 run` looks; only the command is put on PATH.
        ("bin", ["bin/uav-vslam"]),
    ],
    zip_safe=False,
    extras_require={
        "surf": ["mahotas==1.4.19"],  # as in requirements/lock.txt
        "test": ["pytest"],  # tells `colcon test` to use pytest
    },
    entry_points={
        "console_scripts": [
            "uav-vslam = uav_vslam.cli.start:main",
            "replay = uav_vslam.ros.start:main",
            "stereo_frontend = uav_vslam.ros.start:main",
            "ins_propagator = uav_vslam.ros.start:main",
            "slam_backend = uav_vslam.ros.start:main",
            "fusion = uav_vslam.ros.start:main",
            "mapper = uav_vslam.ros.start:main",
            "link_emulator = uav_vslam.ros.start:main",
            "recorder = uav_vslam.ros.start:main",
        ],
    },
)
