# SPDX-License-Identifier: Apache-2.0
"""What the INS's diagnostics say of its inputs: readings with gaps or in bursts, image stamps, late corrections."""

from uav_vslam.ros.calibration import ImuListener
from uav_vslam.ros.health import RECENT_S, RecentEvents
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import NS_PER_S

OF_INPUTS = "lag", "clocks", "images", "imu"  # alarms
SILENT_NS = 2 * NS_PER_S  # of readings without a new stamp of an image
MAX_LAG_S = 2.0  # of the back end's corrections
MAX_APART_S = 2.0  # between the stamps of an image and of the newest reading when it arrives,
APART = 5  # and so many images in a row


class InsStatus:
    """Keeps a node's counts and alarms up to date with its inputs."""

    def __init__(self, node: VehicleNode, sensors: ImuListener) -> None:
        """Begin before the first reading."""
        self._node, self._sensors = node, sensors
        self.restart()

    def restart(self) -> None:
        """Begin again, before the first reading of another flight."""
        self._gaps = RecentEvents()
        self._reading_ns = -1  # the newest when the newest image came
        self._first_ns: int | None = None  # stamps of the first and the newest reading on the time line
        self._newest_ns: int | None = None
        self._image_came_ns: int | None = None  # by the clock that is ahead, should they differ
        self._apart = 0  # images in a row
        for subject in OF_INPUTS:
            self._node.alarms.pop(subject, None)

    def report_lag(self, corrected_ns: int) -> None:
        """Warn while the back end's corrections are late: everything after the INS is then as late.

        Args:
            corrected_ns: stamp of the newest correction [ns].
        """
        lag_s = 0.0 if self._newest_ns is None else (self._newest_ns - corrected_ns) / NS_PER_S
        text = f"the back end's estimate is {lag_s:.1f} s behind the readings: it or the front end does not keep up"
        self._node.report_alarm("lag", text if lag_s > MAX_LAG_S else "", logged=True)

    def report_image(self, reading_ns: int, image_ns: int) -> None:
        """Warn while one image after the other comes with a stamp that is far from the newest reading's.

        A single one may be off; and while no reading comes, images are ahead whatever their clock.

        Args:
            reading_ns: stamp of the newest reading [ns]; negative for none.
            image_ns: new stamp of an image [ns].
        """
        went_on, self._image_came_ns = reading_ns != self._reading_ns, max(reading_ns, image_ns)
        self._reading_ns = reading_ns
        ahead_s = (image_ns - reading_ns) / NS_PER_S
        if not went_on or reading_ns < 0:
            return
        self._apart = self._apart + 1 if abs(ahead_s) > MAX_APART_S else 0
        text = f"stamps of images are {abs(ahead_s):.1f} s {'ahead of' if ahead_s > 0 else 'behind'} those of the IMU"
        self._node.report_alarm(
            "clocks",
            f"{text} when they arrive: do their clocks agree, or are images late?" if self._apart >= APART else "",
            logged=True,
        )

    def report_reading(self, reading_ns: int) -> None:
        """Warn while readings go on without new stamps of images: a camera_info that comes once, or is not stamped.

        Args:
            reading_ns: stamp of the newest reading on the time line [ns].
        """
        self._newest_ns = reading_ns
        self._first_ns = reading_ns if self._first_ns is None else self._first_ns
        if self._image_came_ns is None or reading_ns - max(self._image_came_ns, self._first_ns) <= SILENT_NS:
            self._node.alarms.pop("images", None)
        elif "images" not in self._node.alarms:
            topics, has_infos = self._node.config.input.topics, self._sensors.setup.needs_infos
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

    def report_stamps(self, text: str) -> None:
        """Warn of readings that come in bursts, or too seldom, while they do."""
        self._node.report_alarm("imu_stamps", text, logged=True)
