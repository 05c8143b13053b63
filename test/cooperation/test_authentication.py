# SPDX-License-Identifier: Apache-2.0
"""Only the holder of the key can make a tag, and it covers every field."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.authentication import Authentication, FleetKey, NoAuthentication, authentication_for
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.errors import ConfigError, InvalidMessage
from uav_vslam.slam.packet import checksum, payload_bytes
from uav_vslam.types import LandmarkPacket

FLEET = ("uav1", "uav2", "uav3")


def pem(key: Ed25519PrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def public_pem(key) -> bytes:
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


@pytest.fixture
def with_fleet_key(tmp_path: Path) -> Callable[[str], Authentication]:
    """Return the authentication of each vehicle of a fleet with one secret."""
    path = tmp_path / "fleet.key"
    path.write_bytes(bytes(range(32)))
    return lambda vehicle: authentication_for(vehicle, FusionConfig(fleet_key_file=str(path)))


def signing(folder: Path, vehicle: str) -> FusionConfig:
    return FusionConfig(signing_key_file=str(folder / f"{vehicle}.key"), peer_keys_folder=str(folder / "keys"))


@pytest.fixture
def folder_of_keys(tmp_path: Path) -> Path:
    """A folder with each vehicle's key, and with the public ones in `keys`."""
    (tmp_path / "keys").mkdir()
    for k, vehicle in enumerate(FLEET):
        key = Ed25519PrivateKey.from_private_bytes(bytes([k]) * 32)
        (tmp_path / f"{vehicle}.key").write_bytes(pem(key))
        (tmp_path / "keys" / f"{vehicle}.pem").write_bytes(public_pem(key))
    return tmp_path


@pytest.fixture(params=["fleet", "vehicle"])
def keyed(request: pytest.FixtureRequest) -> Callable[[str], Authentication]:
    """Return the authentication of each vehicle, for either kind of key."""
    if request.param == "fleet":
        return request.getfixturevalue("with_fleet_key")
    folder = request.getfixturevalue("folder_of_keys")
    return lambda vehicle: authentication_for(vehicle, signing(folder, vehicle))


def refusal(authentication: Authentication, packet: LandmarkPacket) -> str:
    try:
        authentication.check(packet)
    except InvalidMessage as error:
        return error.reason
    return ""


def test_peers_accept_what_a_member_signed(keyed, make_small_packet) -> None:
    sender = keyed("uav2")
    packet = sender.sign(make_small_packet(1))
    assert len(packet.tag) == sender.tag_bytes
    assert refusal(keyed("uav1"), packet) == refusal(keyed("uav3"), packet) == ""


CHANGES = {
    "no tag": {"tag": b""},
    "a tag of zeros": {"tag": bytes(16)},
    "another length": {"tag": bytes(17)},
    "another stamp": {"stamp_ns": 5},
    "another sender": {"vehicle": "uav3", "sources": ("uav3/1",)},
    "another session": {"session": 9, "sources": ("uav2/9",)},
    "another sequence": {"sequence": 2},
    "another source": {"sources": ("uav2/1", "uav9/1")},
    "another prior": {"prior_id": "map"},
    "other ids": {"ids": np.array([7], np.uint32)},
    "another origin": {"origin": np.array([1, 2, 3], np.int32)},
    "another scale": {"covariance_scale": 1.25},
    "other descriptors": {"descriptors": np.zeros((1, 128), np.uint8)},
}


@pytest.mark.parametrize("change", CHANGES)
def test_any_change_in_transit_is_detected_even_with_a_new_checksum(keyed, make_small_packet, change: str) -> None:
    packet = dataclasses.replace(keyed("uav2").sign(make_small_packet(1)), **CHANGES[change])
    packet = dataclasses.replace(packet, checksum=checksum(packet))
    assert refusal(keyed("uav1"), packet) == ("signature" if packet.tag else "unsigned")


def test_a_changed_position_is_detected(keyed, make_small_packet) -> None:
    packet = keyed("uav2").sign(make_small_packet(1))
    moved = dataclasses.replace(packet.points, offsets=packet.points.offsets + np.float32(1.0))
    assert refusal(keyed("uav1"), dataclasses.replace(packet, points=moved)) == "signature"


def test_another_fleets_key_is_rejected(with_fleet_key, make_small_packet) -> None:
    assert refusal(with_fleet_key("uav1"), FleetKey(b"x" * 32).sign(make_small_packet(1))) == "signature"


def test_vehicle_keys_prevent_impersonation_by_a_member_and_a_fleet_key_does_not(
    with_fleet_key, folder_of_keys, make_small_packet
) -> None:
    as_uav2 = make_small_packet(1, vehicle="uav2")
    assert refusal(with_fleet_key("uav1"), with_fleet_key("uav3").sign(as_uav2)) == ""
    uav1, uav3 = (authentication_for(v, signing(folder_of_keys, v)) for v in ("uav1", "uav3"))
    assert refusal(uav1, uav3.sign(as_uav2)) == "signature"
    assert refusal(uav1, as_uav2) == "unsigned"


def test_a_vehicle_without_a_known_key_is_rejected(folder_of_keys, make_small_packet) -> None:
    (folder_of_keys / "keys" / "uav2.pem").unlink()
    uav1, uav2 = (authentication_for(v, signing(folder_of_keys, v)) for v in ("uav1", "uav2"))
    assert refusal(uav1, uav2.sign(make_small_packet(1))) == "signature"


def test_without_keys_every_packet_is_accepted(make_small_packet) -> None:
    open_fleet = authentication_for("uav1", FusionConfig())
    assert isinstance(open_fleet, NoAuthentication)
    packet = make_small_packet(1)
    assert open_fleet.sign(packet) is packet
    assert refusal(open_fleet, packet) == ""
    assert open_fleet.tag_bytes == 0


def test_unusable_keys_are_reported(folder_of_keys: Path, tmp_path: Path) -> None:
    def complaint(**settings: str) -> str:
        with pytest.raises(ConfigError) as error:
            authentication_for("uav1", FusionConfig(**{k: str(v) for k, v in settings.items()}))
        return str(error.value)

    own, keys = folder_of_keys / "uav1.key", folder_of_keys / "keys"
    (tmp_path / "short").write_bytes(bytes(15))
    (tmp_path / "empty").mkdir()
    curve = generate_private_key(SECP256R1())
    (tmp_path / "curve.key").write_bytes(curve.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    locked = Ed25519PrivateKey.generate().private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"password")
    )
    (tmp_path / "locked.key").write_bytes(locked)
    assert "16 random bytes" in complaint(fleet_key_file=tmp_path / "short")
    assert "can't be read" in complaint(fleet_key_file=tmp_path / "nowhere")
    assert "PEM" in complaint(signing_key_file=tmp_path / "short", peer_keys_folder=keys)
    assert "password" in complaint(signing_key_file=tmp_path / "locked.key", peer_keys_folder=keys)
    assert "Ed25519" in complaint(signing_key_file=tmp_path / "curve.key", peer_keys_folder=keys)
    assert "no public keys" in complaint(signing_key_file=own, peer_keys_folder=tmp_path / "empty")
    assert "not the key of uav1" in complaint(signing_key_file=folder_of_keys / "uav2.key", peer_keys_folder=keys)
    (keys / "uav4.pem").write_bytes(public_pem(curve))
    assert "uav4.pem: not an Ed25519 key" in complaint(signing_key_file=own, peer_keys_folder=keys)
    (keys / "uav4.pem").write_bytes(b"garbage")
    assert "uav4.pem: no public key" in complaint(signing_key_file=own, peer_keys_folder=keys)


@pytest.mark.parametrize(
    "settings",
    [
        {"fleet_key_file": "a", "signing_key_file": "b", "peer_keys_folder": "c"},
        {"signing_key_file": "b"},
        {"peer_keys_folder": "c"},
    ],
)
def test_half_a_configuration_is_refused(settings: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match="key"):
        FusionConfig(**settings)


def test_a_fleet_with_a_key_fuses_its_own_packets_and_no_strangers(with_fleet_key, make_joint, tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-40, 40, (30, 3))
    uav1, uav2 = (make_joint(points, np.eye(96), vehicle=v, stamp_ns=10**10 * k) for k, v in ((2, "uav1"), (1, "uav2")))
    with_key = FusionConfig(mode="narrowband", fleet_key_file=str(tmp_path / "fleet.key"))
    receiver, member = Fusion("uav1", with_key), Fusion("uav2", with_key)
    stranger = Fusion("uav2", dataclasses.replace(with_key, fleet_key_file=""))
    for fusion in (stranger, member):
        fusion.fuse(uav2)
    with pytest.raises(InvalidMessage, match="unsigned"):
        receiver.inbox.add(stranger.packet())
    assert receiver.fuse(uav1).common == {}
    packet = member.packet()
    assert payload_bytes(packet) <= 1340
    receiver.inbox.add(packet)
    assert receiver.fuse(uav1).common == {"uav2": len(packet)}
