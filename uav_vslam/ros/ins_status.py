# SPDX-License-Identifier: Apache-2.0
"""What the INS's diagnostics say of its inputs: readings with gaps or in bursts, image stamps, late corrections."""

from uav_vslam.ros.calibration import ImuListener
from uav_vslam.ros.health import RECENT_S, RecentEvents
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import NS_PER_S

SILENT_NS = 2 * NS_PER_S  # of readings without a new stamp of an image
MAX_LAG_S = 2.0  # of the back end's corrections


class InsStatus:
    """Keeps a node's counts and alarms up to date with its inputs."""

    def __init__(self, node: VehicleNode, sensors: ImuListener) -> None:
        """Begin before the first reading."""
        self._node, self._sensors = node, sensors
        self._gaps = RecentEvents()

    def report_lag(self, lag_s: float) -> None:
        """Warn while the back end's corrections are late: everything after the INS is then as late."""
        text = f"the back end's estimate is {lag_s:.1f} s behind the readings: it or the front end does not keep up"
        self._node.report_alarm("lag", text if lag_s > MAX_LAG_S else "", logged=True)

    def report_image_stamps(self, reading_ns: int, image_ns: int) -> None:
        """Warn while readings go on without new stamps of images: a camera_info that comes once, or is not stamped.

        Args:
            reading_ns: stamp of the newest reading [ns].
            image_ns: newest stamp of an image [ns]; negative for none.
        """
        if image_ns < 0 or reading_ns - image_ns <= SILENT_NS:
            self._node.alarms.pop("images", None)
        elif "images" not in self._node.alarms:
            topics, has_infos = self._node.config.input.topics, self._sensors.has_infos
            instead = "; a file with the calibration can replace it (input.calibration)" if has_infos else ""
            text = (
                f"{topics.left_info if has_infos else topics.left} has brought no new stamp for "
                f"{SILENT_NS / NS_PER_S:g} s of readings: it has to come with each image, and with its stamp{instead}"
            )
            self._node.report_alarm("images", text, logged=True)

    def report_gaps(self, stamp_ns: int, gaps: int) -> None:
        """Count increments with gaps in their readings, and warn of them for a while: not of those between bursts."""
        self._node.counts["imu_gaps"] += gaps
        recent = self._gaps.count(stamp_ns, gaps)
        text = f"{recent} increments of the last {RECENT_S:g} s lack IMU readings"
        self._node.report_alarm("imu", text if recent and "imu_stamps" not in self._node.alarms else "")

    def report_bursts(self, text: str) -> None:
        """Warn of readings stamped in bursts while they are."""
        self._node.report_alarm("imu_stamps", text, logged=True)
