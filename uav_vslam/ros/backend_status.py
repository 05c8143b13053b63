# SPDX-License-Identifier: Apache-2.0
"""What the back end's diagnostics say of its frames: counts, coasting, recoveries, warnings."""

from uav_vslam.ros.health import RECENT_S, RecentEvents
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import COASTING_REMEDY, MIN_FEATURES

OF_FRAMES = "coasted", "recovery", "warning"  # alarms
MANY_COASTED, MANY_BLIND = 5, 30  # frames of the last `RECENT_S`; a camera may be covered for a moment


class BackendStatus:
    """Keeps a node's counts, notes and alarms up to date with the frames."""

    def __init__(self, node: VehicleNode) -> None:
        """Begin before the first frame."""
        self._node = node
        self.restart()

    def restart(self) -> None:
        """Begin again: alarms are of the frames of one session, and the next one may wait long for its first."""
        self._recoveries, self._recovery = RecentEvents(), ""
        self._coasted, self._blind, self._warned = RecentEvents(), RecentEvents(), RecentEvents()
        for subject in OF_FRAMES:
            self._node.alarms.pop(subject, None)

    def report(self, output: FrameOutput) -> None:
        """Count a frame, note what the map holds, and set or clear the alarms."""
        node, report = self._node, output.report
        node.counts["frames"] += 1
        node.counts["frames_coasted"] += report.coasted
        node.counts["relocalisations"] += report.relocalised
        node.counts["closures"] += report.closures
        node.counts["recoveries"] += report.recovery != ""
        self._report_recoveries(report)
        self._report_coasting(report)
        node.notes["landmarks"] = str(report.landmarks)
        node.notes["associated"] = str(report.associated)
        if report.innovation is not None:
            node.notes["nis_per_dof"] = f"{report.innovation.nis / max(report.innovation.dof, 1):.2f}"
        if report.time_offset is not None:
            offset = report.time_offset
            node.notes["time_offset"] = f"{1e3 * offset.mean_s:+.2f} ± {1e3 * offset.sigma_s:.2f} ms"
        if report.disparity is not None:
            node.notes["disparity_error"] = f"{report.disparity.mean_px:+.3f} ± {report.disparity.sigma_px:.3f} px"
        for text in output.warnings:
            node.get_logger().warning(text)
            node.notes["warning"] = node.alarms["warning"] = text
        if not self._warned.count(report.pose.stamp_ns, len(output.warnings)):
            node.alarms.pop("warning", None)

    def _report_coasting(self, report: FrameReport) -> None:
        """Warn while the estimate goes on by the IMU alone, though frames have features or because they have not."""
        stamp_ns, sees = report.pose.stamp_ns, report.features >= MIN_FEATURES
        coasted = self._coasted.count(stamp_ns, report.coasted and sees)
        blind = self._blind.count(stamp_ns, report.coasted and not sees)
        text = ""
        if coasted >= MANY_COASTED:
            text = (
                f"{coasted} frames of the last {RECENT_S:g} s had features, but none where the estimate "
                f"expects it: {COASTING_REMEDY}"
            )
        elif blind >= MANY_BLIND:
            text = f"{blind} frames of the last {RECENT_S:g} s had fewer than {MIN_FEATURES} features: see front end"
        self._node.report_alarm("coasted", text)

    def _report_recoveries(self, report: FrameReport) -> None:
        """Warn while the filter was re-initialised recently: what it claims is then no more than a guess."""
        self._recovery = report.recovery or self._recovery
        recent = self._recoveries.count(report.pose.stamp_ns, report.recovery != "")
        text = f"the filter was re-initialised {recent}x in the last {RECENT_S:g} s, the last time: {self._recovery}"
        self._node.report_alarm("recovery", text if recent else "")
