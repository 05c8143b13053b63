# SPDX-License-Identifier: Apache-2.0
"""The thesis's map sharing schemes, which write a peer's estimates into the own filter; baselines only.

Once a peer's information is in the filter, the next packet carries it back as if it were independent, and nothing
records what was counted how often. None of these is consistent; only the study uses them, never a node.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.cooperation.own_landmarks import OwnLandmarks
from uav_vslam.cooperation.peer_associators import associate
from uav_vslam.errors import UavVslamError
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.covariance_intersection import minimising_weight
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.numerics import cholesky, inverse_spd, symmetrise
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.epochs import crosses_epoch
from uav_vslam.slam.packet import PacketPolicy, make_packet
from uav_vslam.studies.engine.own_only import Flight, Track
from uav_vslam.types import JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]
Pairs = NDArray[np.int64]


@dataclasses.dataclass(frozen=True, slots=True)
class Shared:
    """Landmarks that two vehicles have in common, as estimated by the sender.

    Attributes:
        ids: (K,) the sender's.
        positions: (K, 3) [m].
        information: (3K, 3K) their marginal.
    """

    ids: NDArray[np.uint32]
    positions: Array
    information: Array

    @classmethod
    def of(cls, packet: LandmarkPacket, rows: Pairs) -> "Shared":
        """Return a packet's estimate of some of its landmarks."""
        at = landmark_rows(0, rows)
        Y = inverse_spd(packet.covariance[np.ix_(at, at)], "covariance of a packet")
        return cls(packet.ids[rows], packet.positions[rows], Y)


Write = Callable[[Filter, Pairs, Shared, Shared | None], None]


@dataclasses.dataclass(frozen=True, slots=True)
class WriteBack:
    """One of the thesis's map sharing schemes.

    Attributes:
        write: writes a peer's estimate into the own filter.
        channel: content sent over the radio, with the section of the thesis.
        sends_own: send the map of a filter that no peer writes to; otherwise the one that includes peers' information.
    """

    write: Write
    channel: str
    sends_own: bool = False


def intersect_each(own: Filter, rows: Pairs, received: Shared, before: Shared | None) -> None:
    """Covariance intersection of each landmark alone, Eq. (7.1) and (7.2); the result replaces the own estimate."""
    del before
    P_received = inverse_spd(received.information, "a peer's landmarks")
    for k, row in enumerate(rows.tolist()):
        at = landmark_rows(own.vehicle, np.array([row]))
        P = own.belief.covariance(np.array([row]))[-3:, -3:]
        Y = inverse_spd(P, "covariance of a landmark")
        Y_fused, share = _intersection(Y, _block(P_received, k))
        _add_information(own, at, Y_fused - Y, share @ (received.positions[k] - own.landmarks[row]))


def overwrite(own: Filter, rows: Pairs, received: Shared, before: Shared | None) -> None:
    """Intersect as `intersect_each`, but replace only the covariance's diagonal block, not its cross-covariances."""
    del before
    P_received = inverse_spd(received.information, "a peer's landmarks")
    P = own.covariance()
    delta = np.zeros(len(P))
    for k, row in enumerate(rows.tolist()):
        at = slice(own.vehicle + 3 * row, own.vehicle + 3 * row + 3)
        Y_fused, share = _intersection(inverse_spd(P[at, at], "covariance of a landmark"), _block(P_received, k))
        P[at, at] = np.linalg.inv(Y_fused)
        delta[at] = P[at, at] @ share @ (received.positions[k] - own.landmarks[row])
    own.correct(InformationBelief(inverse_spd(P, "overwritten covariance"), own.vehicle), delta)


def add_deltas(own: Filter, rows: Pairs, received: Shared, before: Shared | None) -> None:
    """Add the increase of the peer's information since its last packet, Eq. (4.5.9) to (4.5.11)."""
    if before is None:
        return
    _, new, old = np.intersect1d(received.ids, before.ids, return_indices=True)
    if len(new) == 0:
        return
    now, then = landmark_rows(0, new), landmark_rows(0, old)
    at = landmark_rows(own.vehicle, rows[new])
    x = own.landmarks[rows[new]].ravel()
    Y_now, Y_then = _marginal(received.information, now), _marginal(before.information, then)
    gradient = Y_now @ (received.positions[new].ravel() - x) - Y_then @ (before.positions[old].ravel() - x)
    _add_information(own, at, Y_now - Y_then, gradient)


FUSED, OWN = "fused maps, all landmarks (7.4.2, wideband)", "own maps, all landmarks (7.4.2, narrowband)"
WRITE_BACK = {
    "landmark_ci": WriteBack(intersect_each, FUSED),
    "landmark_ci_own": WriteBack(intersect_each, OWN, sends_own=True),
    "overwrite": WriteBack(overwrite, FUSED),
    "deltas": WriteBack(add_deltas, "growth of fused maps since they were sent last (4.5.1)"),
    "deltas_own": WriteBack(add_deltas, "growth of own maps since they were sent last", sends_own=True),
}


def fly_with_write_back(flights: Sequence[Flight], config: VehicleConfig, scheme: WriteBack) -> dict[str, Track]:
    """Fly two or more vehicles that write received packets into their filters at each epoch, until one diverges."""
    backends = {flight.vehicle.name: _backend(flight, config) for flight in flights}
    senders = {flight.vehicle.name: _backend(flight, config) for flight in flights} if scheme.sends_own else backends
    names = list(backends)
    received: dict[tuple[str, str], Shared] = {}
    poses: dict[str, list[PoseEstimate]] = {name: [] for name in names}
    failure, previous_ns = "", None
    for steps in zip(*(flight.steps for flight in flights), strict=True):
        try:
            for name, (features, increment) in zip(names, steps, strict=True):
                report = backends[name].process(features, increment)
                failure = failure or report.recovery
                if scheme.sends_own:
                    senders[name].process(features, increment)
            stamp_ns = backends[names[0]].stamp_ns
            if crosses_epoch(previous_ns, stamp_ns, config.fusion.epoch_s):
                _exchange(backends, senders, received, config, scheme.write)
            previous_ns = stamp_ns
            for name in names:
                poses[name].append(backends[name].filter.nav_estimate().pose)
        except (UavVslamError, np.linalg.LinAlgError) as error:
            failure = failure or f"{type(error).__name__}: {error}"
        if failure:
            break
    shortest = min(map(len, poses.values()))
    return {name: Track(Trajectory.from_estimates(poses[name][:shortest]), failure) for name in names}


class _OpenBackend(SlamBackend):
    """A back end whose filter others may write to."""

    @property
    def filter(self) -> Filter:
        return self._filter


def _backend(flight: Flight, config: VehicleConfig) -> _OpenBackend:
    vehicle = flight.vehicle
    config = dataclasses.replace(config, imu=vehicle.scenario.imu_config)
    return _OpenBackend(vehicle.initial, rig=vehicle.rig, config=config, vehicle=vehicle.name)


def _exchange(
    backends: Mapping[str, _OpenBackend],
    senders: Mapping[str, _OpenBackend],
    received: dict[tuple[str, str], Shared],
    config: VehicleConfig,
    write: Write,
) -> None:
    """Send each vehicle's map to every other one, as it was before the exchange."""
    packets = {name: _everything(backend.joint_information()) for name, backend in senders.items()}
    joints = {name: backend.joint_information() for name, backend in backends.items()}
    for receiver, sender in itertools.permutations(backends, 2):
        packet, own = packets[sender], joints[receiver]
        pairs = associate(OwnLandmarks.of(own), packet, config=config.fusion)
        if len(pairs):
            shared = Shared.of(packet, pairs[:, 1])
            write(backends[receiver].filter, pairs[:, 0], shared, received.get((sender, receiver)))
            received[sender, receiver] = shared


def _everything(joint: JointInformation) -> LandmarkPacket:
    return make_packet(joint, sequence=1, policy=PacketPolicy(max_landmarks=max(len(joint.ids), 1)))


def _block(P: Array, k: int) -> Array:
    """Return the information of landmark k alone."""
    return inverse_spd(P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], "covariance of a peer's landmark")


def _intersection(Y: Array, Y_received: Array) -> tuple[Array, Array]:
    """Return the information w Y + (1 - w) Y_received of the largest determinant, and the peer's share of it."""
    w = minimising_weight(lambda w: -float(np.linalg.slogdet(w * Y + (1.0 - w) * Y_received)[1]))
    return w * Y + (1.0 - w) * Y_received, (1.0 - w) * Y_received


def _marginal(Y: Array, rows: NDArray[np.int64]) -> Array:
    P = inverse_spd(Y, "information")
    return inverse_spd(P[np.ix_(rows, rows)], "covariance")


def _add_information(own: Filter, at: NDArray[np.int64], Y_more: Array, gradient: Array) -> None:
    """Add information, which may be negative, about some rows and update the mean."""
    Y = own.belief.information(np.arange(own.belief.size))
    Y[np.ix_(at, at)] += Y_more
    Y = symmetrise(Y)
    cholesky(Y, "information with a peer's")
    g = np.zeros(len(Y))
    g[at] = gradient
    own.correct(InformationBelief(Y, own.vehicle), np.asarray(np.linalg.solve(Y, g), dtype=np.float64))
