# SPDX-License-Identifier: Apache-2.0
"""The evaluate verb scores what the recorder wrote, made up here with known errors."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.cli import evaluate, progress
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import encode, message
from uav_vslam.datasets.message_builders import camera_info_message, truth_message
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.datasets.outputs import read_outputs
from uav_vslam.datasets.rosbag import iter_raw
from uav_vslam.errors import BagError
from uav_vslam.evaluation.files.tables import read_columns
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp

START_NS = 1_283_212_800_000_000_007
FRAMES = 60
TRUTH = "/uav1/ground_truth/odometry"
CAMERA = PinholeCamera(64, 48, 80.0, 80.0, 32.0, 24.0)


def odometry(k, north_error_m, sigma_m):
    pose = Pose(so3_exp([0.0, 0.0, 0.01 * k]), np.array([2.0 * k, north_error_m, 70.0]))
    sample = TruthSample(START_NS + 100_000_000 * k, pose, np.zeros(3), np.zeros(3))
    built = truth_message(sample, "uav1")
    built.pose.covariance[:] = np.diag([sigma_m**2] * 3 + [1e-4] * 3).ravel()
    return sample.stamp_ns, built


def status(vehicle, k, mode, peers):
    header = odometry(k, 0.0, 0.0)[1].header
    links = [
        message(
            "uav_vslam_msgs/msg/PeerLink", peer=peer, session=1, last_sequence=k, packets_received=k,
            packets_used=k - 1, packets_waiting=0, received_bytes=1000 * k, received_bytes_per_s=1234.5,
            drop_reasons=["stale"], drop_counts=np.array([1], np.uint64), common_landmarks=9, age_s=0.1, silent=False,
        )
        for peer in peers
    ]  # fmt: skip
    return message(
        "uav_vslam_msgs/msg/FusionStatus", header=header, vehicle=vehicle, mode=mode, own_weight=1.0, packets_sent=k,
        packets_held_back=2, bytes_sent=1000 * k, sent_bytes_per_s=1234.5, recent_bytes_per_s=1000.0, peers=links,
        radio_interface="", wire_sent_bytes=0, wire_received_bytes=0, wire_sent_bytes_per_s=0.0,
    )  # fmt: skip


def write_flight(folder, fleet=("uav1", "uav2"), mode="wideband"):
    """Write estimates and inputs bags; S-SLAM errs by 1 m, C-SLAM by 0.5 m, the INS up to 30 m."""
    with RawRecorder(folder / "estimates") as out, RawRecorder(folder / "inputs") as inputs:
        for vehicle in fleet:
            for k in range(FRAMES):
                tracks = {"odometry": 1.0, "fused/odometry": 0.5, "ins/dead_reckoning": 30.0 * k / (FRAMES - 1)}
                for topic, error_m in tracks.items():
                    stamp_ns, built = odometry(k, error_m, 0.5)
                    out.write(f"/{vehicle}/{topic}", "nav_msgs/msg/Odometry", encode(built), stamp_ns)
                stamp_ns, built = odometry(k, 0.0, 0.0)
                inputs.write(f"/{vehicle}/ground_truth/odometry", "nav_msgs/msg/Odometry", encode(built), stamp_ns)
                info = encode(camera_info_message(stamp_ns, "left", CAMERA))
                inputs.write(f"/{vehicle}/left/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns)
            peers = [name for name in fleet if name != vehicle] if mode != "none" else []
            for k in (10, 20):
                then = mode.split(", then ")  # one, or the first and the second status's
                data = encode(status(vehicle, k, then[0] if k == 10 else then[-1], peers))
                stamp_ns = START_NS + 100_000_000 * k
                out.write(f"/{vehicle}/fusion/status", "uav_vslam_msgs/msg/FusionStatus", data, stamp_ns)


def pose_message(kind, odometry):
    """Return the pose of an odometry as another message."""
    if kind == "TransformStamped":
        p = odometry.pose.pose.position
        at = message("geometry_msgs/msg/Vector3", x=p.x, y=p.y, z=p.z)
        moved = message("geometry_msgs/msg/Transform", translation=at, rotation=odometry.pose.pose.orientation)
        return message(f"geometry_msgs/msg/{kind}", header=odometry.header, child_frame_id="base_link", transform=moved)
    pose = odometry.pose.pose if kind == "PoseStamped" else odometry.pose
    return message(f"geometry_msgs/msg/{kind}", header=odometry.header, pose=pose)


def estimates_of_one(pair, folder):
    """Return a bag with the estimates of one vehicle of the pair."""
    with RawRecorder(folder / "alone") as bag:
        for raw in iter_raw([pair / "estimates"], ["/uav1/odometry"]):
            bag.write(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    return folder / "alone"


def quiet(folder):
    return "--results", folder / "results", "--no-plots"


def summary_of(folder):
    return json.loads((folder / "results" / "latest" / "summary.json").read_text())


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    write_flight(folder)
    return folder


def run(*arguments) -> int:
    parser = argparse.ArgumentParser()
    evaluate.add_arguments(parser)
    return evaluate.run(parser.parse_args([str(argument) for argument in arguments]))


@pytest.mark.slow
def test_known_errors_come_out_as_figures(pair, tmp_path, capsys):
    assert run(pair / "estimates", pair / "inputs", "--results", tmp_path, "--name", "made up") == 0
    summary = json.loads((tmp_path / "latest" / "summary.json").read_text())
    vehicle = summary["vehicles"]["uav2"]
    assert (vehicle["frames_in"], vehicle["frames_processed"]) == (FRAMES, FRAMES)
    assert vehicle["distance_m"] == pytest.approx(2.0 * (FRAMES - 1))
    assert vehicle["ins"]["end_m"] == pytest.approx(30.0)
    assert vehicle["s_slam"]["ate_m"] == pytest.approx(1.0)
    assert vehicle["c_slam"]["ate_m"] == pytest.approx(0.5)
    assert vehicle["s_slam"]["nees_position"] == pytest.approx((1.0 / 0.5) ** 2 / 3)
    assert vehicle["link"] == {
        "sent_bytes_per_s": 1234.5, "packets_sent": 20, "packets_received": 20, "packets_used": 19,
        "packets_waiting": 0,
        "dropped": {"budget": 2, "stale": 1},
    }  # fmt: skip
    assert (summary["name"], summary["mode"], summary["realtime_factor"]) == ("made up", "wideband", None)
    assert summary["duration_s"] == pytest.approx(0.1 * (FRAMES - 1))
    printed = capsys.readouterr().out
    assert "C-SLAM" in printed
    assert str((tmp_path / "latest").resolve().name) in printed


@pytest.mark.slow
def test_plots_and_tracks_are_written(pair, tmp_path):
    run(pair / "estimates", pair / "inputs", "--results", tmp_path)
    names = {path.name for path in (tmp_path / "latest").iterdir()}
    assert {"plan_view.png", "report.html", "errors.png", "uav1_c_slam.tum", "uav2_truth.tum", "config.yaml"} <= names
    link = read_columns(tmp_path / "latest" / "uav1_link.csv")
    assert (link["packets_sent"], link["packets_used"]) == (["10", "20"], ["9", "19"])  # the two statuses recorded


def test_estimates_alone_are_evaluated_without_truth(pair, tmp_path):
    assert run(pair / "estimates", "--results", tmp_path, "--no-plots") == 0
    vehicle = json.loads((tmp_path / "latest" / "summary.json").read_text())["vehicles"]["uav1"]
    assert vehicle["s_slam"]["ate_m"] is None
    assert vehicle["frames_in"] is None
    assert not list((tmp_path / "latest").glob("*.png"))


@pytest.mark.parametrize(("fleet", "mode"), [(("uav1", "uav2"), "none"), (("uav1",), "wideband")])
def test_a_vehicle_without_peer_has_no_cooperative_track(tmp_path, fleet, mode):
    write_flight(tmp_path, fleet, mode)
    run(tmp_path / "estimates", tmp_path / "inputs", "--results", tmp_path / "results", "--no-plots")
    summary = json.loads((tmp_path / "results" / "latest" / "summary.json").read_text())
    assert summary["vehicles"]["uav1"]["c_slam"] is None
    assert summary["pooled"]["c_slam"] is None
    assert summary["mode"] == mode


def test_a_vehicle_that_was_switched_to_none_in_flight_keeps_its_cooperative_track(tmp_path):
    write_flight(tmp_path, mode="wideband, then none")
    run(tmp_path / "estimates", tmp_path / "inputs", "--results", tmp_path / "results", "--no-plots")
    summary = json.loads((tmp_path / "results" / "latest" / "summary.json").read_text())
    assert summary["mode"] == "none"
    assert summary["vehicles"]["uav2"]["c_slam"]["ate_m"] == pytest.approx(0.5)


def test_recorded_frames_are_judged_without_truth(tmp_path, capsys):
    with RawRecorder(tmp_path / "estimates") as bag:
        for k in range(FRAMES):
            stamp_ns, built = odometry(k, 0.0, 0.5)
            bag.write("/uav1/odometry", "nav_msgs/msg/Odometry", encode(built), stamp_ns)
            coasted = k in (0, 10, 11)
            quality = message(
                "uav_vslam_msgs/msg/FrameQuality", header=built.header, features=300, tracked=200, associated=25,
                downweighted=1, landmarks=80, coasted=coasted, relocalised=False, restarted=k == 12,
                closures=2 * (k == 5), nis=100.0 * (not coasted), dof=100 * (not coasted), gate_probability=0.99,
                events=["lost"] * (k == 12), time_offset_s=-0.0155, time_offset_sigma_s=2e-4, disparity_error_px=0.0,
                disparity_error_sigma_px=0.0,
            )  # fmt: skip
            bag.write("/uav1/slam/quality", "uav_vslam_msgs/msg/FrameQuality", encode(quality), stamp_ns)
    assert run(tmp_path / "estimates", "--results", tmp_path / "results", "--no-plots") == 0
    vehicle = json.loads((tmp_path / "results" / "latest" / "summary.json").read_text())["vehicles"]["uav1"]
    quality = vehicle["quality"]
    assert (vehicle["closures"], quality["closures"], quality["restarts"]) == (2, 2, 1)
    assert (quality["frames_coasted"], quality["coasted_longest"], quality["nis_per_dof"]) == (3, 2, 1.0)
    assert quality["events"] == [{"time_s": pytest.approx(1.2), "text": "lost"}]
    assert quality["alarms"] is None
    assert quality["calibration"]["time_offset_ms"] == pytest.approx(-15.5)
    assert quality["calibration"]["disparity_error_px"] is None
    printed = capsys.readouterr().out
    assert "consistent: NIS/dof 1 in" in printed
    assert "calibration estimated: exposure -15.50 ± 0.20 ms from the stamp\n" in printed
    rows = (tmp_path / "results" / "latest" / "uav1_frames.csv").read_text().splitlines()
    assert len(rows) == FRAMES + 1


def test_a_recording_without_estimates_says_what_it_holds(pair):
    with pytest.raises(BagError, match=r"inputs; give the bag of the estimates") as refused:
        read_outputs([pair / "inputs"])
    assert str(refused.value).splitlines()[1:] == [
        "  nav_msgs/msg/Odometry: /uav1/ground_truth/odometry, /uav2/ground_truth/odometry",
        "  sensor_msgs/msg/CameraInfo: /uav1/left/camera_info, /uav2/left/camera_info",
    ]


def test_several_passes_of_a_recording_are_refused_and_a_few_repeated_stamps_are_not(tmp_path):
    for name, repeated in (("passes", range(FRAMES)), ("restarted", range(5, 9))):
        with RawRecorder(tmp_path / name) as bag:
            for k in (*range(FRAMES), *repeated):
                stamp_ns, built = odometry(k, 0.0, 0.5)
                bag.write("/uav1/odometry", "nav_msgs/msg/Odometry", encode(built), stamp_ns)
    with pytest.raises(BagError, match=r"/uav1/odometry holds most stamps 2 times: several passes .* one by one"):
        read_outputs([tmp_path / "passes"])
    outputs, _ = read_outputs([tmp_path / "restarted"])
    assert len(outputs["uav1"].own_only) == FRAMES + 4


def test_a_truncated_recording_is_evaluated_up_to_the_damage_and_reported(pair, tmp_path, capsys):
    whole = next((pair / "estimates").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 5 // 8])  # uav1 was written first
    assert run(cut, pair / "inputs", "--results", tmp_path / "results", "--no-plots") == 2
    assert "up to a break" in capsys.readouterr().err
    vehicle = json.loads((tmp_path / "results" / "latest" / "summary.json").read_text())["vehicles"]["uav2"]
    assert 0 < vehicle["frames_processed"] < FRAMES
    assert vehicle["s_slam"]["ate_m"] == pytest.approx(1.0)


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"])
def test_ground_truth_of_every_type_that_is_run_with_is_compared_with(kind, pair, tmp_path):
    with RawRecorder(tmp_path / "truth") as bag:
        for k in range(FRAMES):
            stamp_ns, built = odometry(k, 0.0, 0.0)
            bag.write(TRUTH, f"geometry_msgs/msg/{kind}", encode(pose_message(kind, built)), stamp_ns)
    assert run(estimates_of_one(pair, tmp_path), tmp_path / "truth", *quiet(tmp_path)) == 0
    assert summary_of(tmp_path)["vehicles"]["uav1"]["s_slam"]["ate_m"] == pytest.approx(1.0)


def test_unusable_poses_of_the_ground_truth_are_left_out_with_a_warning(pair, tmp_path, capsys):
    with RawRecorder(tmp_path / "truth") as bag:
        for k in range(FRAMES):
            stamp_ns, built = odometry(k, 0.0, 0.0)
            if k == 20:
                built.pose.pose.position.x = float("nan")
            if k == 30:
                built.pose.pose.orientation.w = built.pose.pose.orientation.z = 0.0
            data = encode(built)
            bag.write(TRUTH, "nav_msgs/msg/Odometry", data[:40] if k == 40 else data, stamp_ns)
    assert run(estimates_of_one(pair, tmp_path), tmp_path / "truth", *quiet(tmp_path)) == 0
    assert "uav1: 3 poses of the ground truth are not finite" in capsys.readouterr().err
    assert summary_of(tmp_path)["vehicles"]["uav1"]["s_slam"]["ate_m"] == pytest.approx(1.0)


def test_ground_truth_that_can_not_be_compared_with_is_warned_of(pair, tmp_path, capsys):
    estimates = estimates_of_one(pair, tmp_path)
    with RawRecorder(tmp_path / "text") as text, RawRecorder(tmp_path / "late") as late:
        data = encode(message("std_msgs/msg/String", data="here"))
        text.write(TRUTH, "std_msgs/msg/String", data, START_NS)
        for k in range(FRAMES):
            stamp_ns, built = odometry(k, 0.0, 0.0)
            built.header.stamp.sec += 1000
            late.write(TRUTH, "nav_msgs/msg/Odometry", encode(built), stamp_ns)
    assert run(estimates, tmp_path / "text", *quiet(tmp_path)) == 0
    assert f"{TRUTH} holds std_msgs/msg/String and is not read" in capsys.readouterr().err
    assert run(estimates, tmp_path / "late", *quiet(tmp_path)) == 0
    assert "uav1: the ground truth is from +1000.00 to +1005.90 s after" in capsys.readouterr().err


def test_odometry_of_another_type_is_no_estimate(tmp_path):
    with RawRecorder(tmp_path / "bad") as bag:
        bag.write("/uav1/odometry", "std_msgs/msg/String", encode(message("std_msgs/msg/String", data="x")), START_NS)
    with pytest.raises(BagError, match=r"of nav_msgs/msg/Odometry in [^\0]* std_msgs/msg/String: /uav1/odometry$"):
        read_outputs([tmp_path / "bad"])
    with RawRecorder(tmp_path / "fused") as bag:
        bag.write("/uav1/odometry", "nav_msgs/msg/Odometry", encode(odometry(0, 0.0, 0.5)[1]), START_NS)
        data = encode(message("std_msgs/msg/String", data="x"))
        bag.write("/uav1/fused/odometry", "std_msgs/msg/String", data, START_NS)
    with pytest.raises(BagError, match=r"/uav1/fused/odometry holds std_msgs/msg/String, not nav_msgs/msg/Odometry"):
        read_outputs([tmp_path / "fused"])


def test_reading_shows_its_progress(pair, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.0)
    assert run(pair / "estimates", pair / "inputs", *quiet(tmp_path)) == 0
    messages = 2 * (4 * FRAMES + 2)  # three tracks, the truth and the statuses of each vehicle
    assert f"reading: {messages} of {messages} after" in capsys.readouterr().err


def test_an_odometry_without_attitude_is_named(tmp_path):
    _, built = odometry(0, 0.0, 1.0)
    for axis in "xyzw":
        setattr(built.pose.pose.orientation, axis, 0.0)
    with RawRecorder(tmp_path / "bad") as bag:
        bag.write("/uav1/odometry", "nav_msgs/msg/Odometry", encode(built), START_NS)
    with pytest.raises(BagError, match=f"/uav1/odometry at {START_NS} ns holds no pose"):
        read_outputs([tmp_path / "bad"])
