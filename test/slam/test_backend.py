# SPDX-License-Identifier: Apache-2.0
"""The frame loop on a simulated flight without images."""

import dataclasses
import itertools

import numpy as np
import pytest

from uav_vslam.config import EXACT_RIG, FILTERS, STATE_MODELS, BackendConfig, RigConfig, VehicleConfig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MAX_LOST
from uav_vslam.slam.map_matching import MapMatcher
from uav_vslam.slam.relocalisation import MIN_INLIERS
from uav_vslam.types import ImuIncrement, StereoFeatures

FRAMES = 25
SYNCHRONISED = RigConfig(time_offset_sigma_s=0.0)


@dataclasses.dataclass(frozen=True)
class Flight:
    vehicle: SimulatedVehicle
    features: list[StereoFeatures]
    increments: list[ImuIncrement | None]  # number k ends at frame k; None for the first

    def backend(self, rig: RigConfig | None = None, **options) -> SlamBackend:
        backend = BackendConfig(**options)
        config = VehicleConfig(imu=self.vehicle.scenario.imu_config, backend=backend, rig=rig or RigConfig())
        return SlamBackend(self.vehicle.initial, rig=self.vehicle.rig, config=config, vehicle="uav1", session=4)

    def fly(self, backend: SlamBackend, features: list[StereoFeatures] | None = None) -> list[FrameReport]:
        return [backend.process(f, i) for f, i in zip(features or self.features, self.increments, strict=True)]

    def position_error_m(self, report: FrameReport) -> float:
        truth = self.vehicle.true_state(report.pose.stamp_ns)
        return float(np.linalg.norm(report.pose.T_map_body.t - truth.T_map_body.t))


@pytest.fixture(scope="module")
def flight() -> Flight:
    vehicle = simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1, seed=3), 0)
    noise = LandmarkNoise(wrong_share=0.1)
    features = [f for f, _ in observe(vehicle, scatter_landmarks([vehicle]), noise=noise)]
    samples, zero = vehicle.imu.samples(), np.zeros(3)
    increments = [
        preintegrate(samples, int(a), int(b), gyro_bias=zero, accel_bias=zero, imu=vehicle.scenario.imu_config)
        for a, b in itertools.pairwise(vehicle.frame_stamps_ns)
    ]
    return Flight(vehicle, features, [None, *increments])


def test_the_first_frame_fills_the_map_and_moves_nothing(flight: Flight) -> None:
    backend = flight.backend(SYNCHRONISED)
    report = backend.process(flight.features[0], None)
    assert report.associated == 0
    assert report.innovation is None
    assert not report.relocalised
    assert report.features == len(flight.features[0])
    assert 0 < report.landmarks <= BackendConfig().max_new_landmarks
    np.testing.assert_array_equal(report.pose.T_map_body.matrix, flight.vehicle.initial.state.T_map_body.matrix)
    ids, positions = backend.landmarks
    assert len(ids) == len(positions) == report.landmarks


def test_an_unsynchronised_rig_adds_the_first_landmarks_as_soon_as_the_rate_is_known(flight: Flight) -> None:
    backend = flight.backend(RigConfig(time_offset_sigma_s=0.01))
    first = backend.process(flight.features[0], flight.increments[0])
    assert first.landmarks == 0
    second = backend.process(flight.features[1], flight.increments[1])
    assert second.associated >= 10  # by then the first frame's are in
    plain = flight.backend(SYNCHRONISED).process(flight.features[0], flight.increments[0])
    np.testing.assert_array_equal(second.late_sightings[:, 1], plain.sightings[:, 1])
    assert np.isin(second.sightings[: second.associated, 0], second.late_sightings[:, 0]).all()
    assert len(plain.late_sightings) == 0


def test_postponed_landmarks_are_where_the_known_rate_puts_them(flight: Flight) -> None:
    """With an offset that is known to a microsecond, the flight is the one with synchronous clocks."""
    backends = [flight.backend(dataclasses.replace(EXACT_RIG, time_offset_sigma_s=sigma_s)) for sigma_s in (0.0, 1e-6)]
    for features, increment in zip(flight.features[:4], flight.increments[:4], strict=True):
        plain, postponing = (backend.process(features, increment) for backend in backends)
    assert postponing.associated == plain.associated
    np.testing.assert_allclose(postponing.pose.T_map_body.t, plain.pose.T_map_body.t, rtol=0, atol=1e-3)


def test_a_tenth_of_wrong_matches_is_rejected(flight: Flight) -> None:
    reports = flight.fly(flight.backend())
    assert min(r.associated for r in reports[1:]) >= 10
    assert not any(r.relocalised for r in reports)
    # 3.4 s after a start with 0.1 m/s and 0.5 degrees of error: half a metre is three times the normal error
    assert flight.position_error_m(reports[-1]) < 0.5
    nis = sum(r.innovation.nis for r in reports[1:]) / sum(r.innovation.dof for r in reports[1:])
    assert 0.7 < nis < 1.1  # gated at 99 %, so a little below one; some thousand degrees of freedom


def test_frames_without_features_are_dead_reckoned_with_growing_covariance(flight: Flight) -> None:
    backend = flight.backend()
    dark = [StereoFeatures.empty(f.stamp_ns) if 8 <= k < 12 else f for k, f in enumerate(flight.features)]
    reports = flight.fly(backend, dark)
    assert [r.associated for r in reports[8:12]] == [0] * 4
    assert all(r.innovation is None for r in reports[8:12])
    sigma = [np.sqrt(np.trace(r.pose.covariance[:3, :3])) for r in reports]
    assert sigma[7] < sigma[8] < sigma[9] < sigma[10] < sigma[11]
    assert reports[12].associated > 0
    assert flight.position_error_m(reports[-1]) < 0.6


def test_landmarks_do_not_age_while_nothing_is_seen(flight: Flight) -> None:
    """In view and unseen for three frames, a landmark seen once is given up; a blackout is no such evidence."""
    dark = [StereoFeatures.empty(f.stamp_ns) if k else f for k, f in enumerate(flight.features[:6])]
    backend = flight.backend()
    reports = [backend.process(*step) for step in zip(dark, flight.increments[:6], strict=True)]
    assert reports[-1].landmarks > 0.5 * reports[0].landmarks


def test_a_start_without_features_is_possible(flight: Flight) -> None:
    dark = [StereoFeatures.empty(f.stamp_ns) if k < 3 else f for k, f in enumerate(flight.features)]
    reports = flight.fly(flight.backend(), dark)
    assert [r.landmarks for r in reports[:3]] == [0, 0, 0]
    assert reports[-1].associated > 0


def test_features_of_another_place_are_rejected(flight: Flight) -> None:
    backend = flight.backend()
    backend.process(flight.features[0], None)
    strange = np.random.default_rng(0).integers(0, 256, flight.features[1].descriptors.shape, np.uint8)
    report = backend.process(dataclasses.replace(flight.features[1], descriptors=strange), flight.increments[1])
    assert report.associated == 0


def test_the_state_never_holds_more_landmarks_than_allowed(flight: Flight) -> None:
    for options in ({"max_landmarks": 30, "max_in_view": 30}, {"max_landmarks": 60, "max_in_view": 45}):
        reports = flight.fly(flight.backend(**options))
        assert max(r.landmarks for r in reports) <= options["max_landmarks"]
        assert reports[-1].associated > 0


@pytest.mark.parametrize("retention", ["grid", "none", "first_last", "largest_covariance"])
def test_every_retention_policy_flies(flight: Flight, retention: str) -> None:
    reports = flight.fly(flight.backend(retention=retention, max_in_view=40, max_landmarks=50))
    assert max(r.landmarks for r in reports) <= 50
    assert flight.position_error_m(reports[-1]) < 0.6


def test_updates_of_a_frame_are_capped(flight: Flight) -> None:
    reports = flight.fly(flight.backend(max_observations=9))
    assert max(r.associated for r in reports) == 9


def test_an_increment_of_the_wrong_interval_is_refused_and_changes_nothing(flight: Flight) -> None:
    backend = flight.backend()
    backend.process(flight.features[0], None)
    before = backend.stamp_ns
    with pytest.raises(ValueError, match="does not span the estimate"):
        backend.process(flight.features[2], flight.increments[2])  # starts at frame 1
    with pytest.raises(ValueError, match="does not span the estimate"):
        backend.process(flight.features[2], flight.increments[1])  # ends at frame 1
    with pytest.raises(ValueError, match="needs the motion since"):
        backend.process(flight.features[1], None)
    assert backend.stamp_ns == before
    assert backend.process(flight.features[1], flight.increments[1]).associated > 0


def test_joint_information_is_an_independent_copy(flight: Flight) -> None:
    backend = flight.backend()
    reports = flight.fly(backend)
    joint = backend.joint_information()
    n = len(joint.ids)
    assert (joint.vehicle, joint.session, joint.stamp_ns) == ("uav1", 4, flight.features[-1].stamp_ns)
    assert joint.information.shape == (6 + 3 * n, 6 + 3 * n)
    assert len(joint.positions) == len(joint.descriptors) == n == reports[-1].landmarks
    P = np.linalg.inv(joint.information)
    # The pose block is the back end's own, up to two inversions (condition number about 1e7).
    np.testing.assert_allclose(P[:6, :6], reports[-1].pose.covariance, rtol=1e-5, atol=1e-12)
    joint.positions[:] = np.nan
    joint.descriptors[:] = 0
    assert np.isfinite(backend.landmarks[1]).all()
    assert backend.joint_information().descriptors.any()


def test_a_frame_and_its_motion_are_not_modified(flight: Flight) -> None:
    pixels, descriptors = flight.features[1].pixels.copy(), flight.features[1].descriptors.copy()
    jacobian = flight.increments[1].bias_jacobian.copy()
    backend = flight.backend()
    flight.fly(backend)
    np.testing.assert_array_equal(flight.features[1].pixels, pixels)
    np.testing.assert_array_equal(flight.features[1].descriptors, descriptors)
    np.testing.assert_array_equal(flight.increments[1].bias_jacobian, jacobian)


def test_a_lost_vehicle_relocalises_in_its_map(flight: Flight) -> None:
    """The start's velocity is wrong by 60 sigma: the truth is outside every gate, but in the map."""
    initial = flight.vehicle.initial
    state = dataclasses.replace(initial.state, v_map=initial.state.v_map + np.array([0.0, 40.0, 0.0]))
    config = VehicleConfig(imu=flight.vehicle.scenario.imu_config)
    backend = SlamBackend(
        dataclasses.replace(initial, state=state), rig=flight.vehicle.rig, config=config, vehicle="uav1"
    )
    backend.process(flight.features[0], None)
    report = backend.process(flight.features[1], flight.increments[1])
    assert report.relocalised
    assert report.associated >= MIN_INLIERS


def test_an_indefinite_filter_is_reinitialised_from_the_imu(flight: Flight) -> None:
    backend = flight.backend()
    reports = []
    for k, (features, increment) in enumerate(zip(flight.features, flight.increments, strict=True)):
        if k == 12:
            backend._filter.belief.Y[3, 3] = -1.0
        reports.append(backend.process(features, increment))
    assert [k for k, r in enumerate(reports) if r.recovery] == [12]
    assert "not positive definite" in reports[12].recovery
    assert reports[12].associated == 0
    assert reports[12].landmarks > 0  # of this same frame
    assert np.trace(reports[13].pose.covariance) > 2 * np.trace(reports[11].pose.covariance)
    assert min(r.associated for r in reports[13:]) >= 10
    assert flight.position_error_m(reports[-1]) < 1.0


def test_a_filter_that_fails_at_frame_after_frame_works_again_as_soon_as_it_can(flight: Flight, monkeypatch) -> None:
    """Each recovery inflates the covariance, but not so far that the filter can only fail at the next frame."""
    backend, failing = flight.backend(), range(2, 18)
    reports = [backend.process(flight.features[k], flight.increments[k]) for k in range(failing.start)]
    with monkeypatch.context() as patch:
        patch.setattr(type(backend._filter.belief), "predicted", singular)
        reports += [backend.process(flight.features[k], flight.increments[k]) for k in failing]
    reports += [backend.process(flight.features[k], flight.increments[k]) for k in range(failing.stop, FRAMES)]
    assert [k for k, r in enumerate(reports) if r.recovery] == list(failing)
    assert min(r.associated for r in reports[failing.stop :]) >= 10
    position_m = np.sqrt(np.trace(reports[-1].pose.covariance[:3, :3]))
    assert flight.position_error_m(reports[-1]) < 3.0 * position_m
    assert position_m < 100.0  # after 16 frames of 0.14 s, at 20 m/s


def singular(*_, **__) -> None:
    raise np.linalg.LinAlgError("Singular matrix")


@pytest.mark.parametrize("step", ["predicted", "updated", "candidates"])
def test_a_matrix_that_numpy_cannot_factor_reinitialises_the_filter(flight: Flight, step: str, monkeypatch) -> None:
    """Raised in prediction, association or update: the frame's motion is integrated either way."""
    backend = flight.backend()
    reports = [backend.process(flight.features[k], flight.increments[k]) for k in range(8)]

    of = MapMatcher if step == "candidates" else type(backend._filter.belief)
    with monkeypatch.context() as patch:
        patch.setattr(of, step, singular)
        reports.append(backend.process(flight.features[8], flight.increments[8]))
    reports += [backend.process(flight.features[k], flight.increments[k]) for k in range(9, FRAMES)]
    assert [k for k, r in enumerate(reports) if r.recovery] == [8]
    assert "Singular matrix" in reports[8].recovery
    assert [r.pose.stamp_ns for r in reports] == [f.stamp_ns for f in flight.features]
    assert flight.position_error_m(reports[-1]) < 1.0


def test_a_filter_that_associates_nothing_for_long_is_reinitialised(flight: Flight) -> None:
    backend = flight.backend(SYNCHRONISED)
    backend._health._lost = MAX_LOST - 1
    reports = [backend.process(flight.features[0], None)]
    elsewhere = [dataclasses.replace(f, descriptors=f.descriptors[::-1]) for f in flight.features]
    for features, increment in zip(elsewhere[1:4], flight.increments[1:4], strict=True):
        reports.append(backend.process(features, increment))
    assert "no landmark associated" in reports[1].recovery
    assert not any(r.recovery for r in reports[2:])
    assert reports[1].landmarks > 0


@pytest.mark.parametrize("model", STATE_MODELS)
@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_flies_with_every_state_model(flight: Flight, name: str, model: str) -> None:
    reports = flight.fly(flight.backend(filter=name, model=model, max_in_view=20, max_landmarks=25))
    assert min(r.landmarks for r in reports[1:]) > 0
    assert not any(r.recovery for r in reports)
    assert flight.position_error_m(reports[-1]) < 1.0


def test_the_thesis_s_h_infinity_filter_flies_with_the_gamma_of_the_thesis(flight: Flight) -> None:
    """Its covariance is indefinite, but singular values give a square root."""
    reports = flight.fly(flight.backend(filter="thesis_uhf", model="euler9", gamma=1.5))
    assert not any(r.recovery for r in reports)
    assert flight.position_error_m(reports[-1]) < 2.0
