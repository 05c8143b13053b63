# SPDX-License-Identifier: Apache-2.0
"""Packet authentication: none, a key that the fleet shares, or a key pair per vehicle.

none          The checksum detects transmission errors, not attackers.
fleet key     HMAC-SHA-256, 16 bytes. Prevents outsiders from forging, altering or renaming packets; not a malicious or
              compromised member from impersonating another.
vehicle keys  Ed25519, 64 bytes. Prevents impersonation too. Not false landmarks of a member itself: only gates and
              consistency checks protect against those.

A tag covers vehicle, session and sequence too, so the inbox detects a replayed packet by them, see
`cooperation.inbox`. Nothing is encrypted.

    uav-vslam keys new fleet.key                                     fusion.fleet_key_file, the same for all
    openssl genpkey -algorithm ed25519 -out uav1.key                 fusion.signing_key_file, stays with uav1
    openssl pkey -in uav1.key -pubout -out keys/uav1.pem             fusion.peer_keys_folder, the same for all
"""

import dataclasses
import hashlib
import hmac
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from uav_vslam.config import FusionConfig, expanded
from uav_vslam.errors import ConfigError, InvalidMessage
from uav_vslam.slam.packet import canonical_bytes
from uav_vslam.types import LandmarkPacket

MIN_KEY_BYTES = 16
HMAC_BYTES = 16  # of the 32: enough against guessing, for a radio
ED25519_BYTES = 64


class Authentication(Protocol):
    """Signs own packets and verifies those of peers."""

    tag_bytes: int

    def sign(self, packet: LandmarkPacket) -> LandmarkPacket:
        """Return the packet with its tag."""

    def check(self, packet: LandmarkPacket) -> None:
        """Raise InvalidMessage, with reason unsigned if the tag is missing, or signature if it is not the sender's."""


class NoAuthentication:
    """Accepts every packet, with or without a tag."""

    tag_bytes = 0

    def sign(self, packet: LandmarkPacket) -> LandmarkPacket:
        """Return the packet unchanged."""
        return packet

    def check(self, packet: LandmarkPacket) -> None:
        """Accept."""


class FleetKey:
    """One shared secret, HMAC-SHA-256 truncated to 16 bytes."""

    tag_bytes = HMAC_BYTES

    def __init__(self, key: bytes) -> None:
        self._key = key

    def sign(self, packet: LandmarkPacket) -> LandmarkPacket:
        """Return the packet with its tag."""
        return dataclasses.replace(packet, tag=self._tag(packet))

    def check(self, packet: LandmarkPacket) -> None:
        """Raise InvalidMessage with reason unsigned or signature, if the packet was made without the key."""
        _require_tag(packet)
        if not hmac.compare_digest(packet.tag, self._tag(packet)):
            raise InvalidMessage("signature", f"packet {packet.sequence} of {packet.source} lacks the fleet's tag")

    def _tag(self, packet: LandmarkPacket) -> bytes:
        return hmac.new(self._key, canonical_bytes(packet), hashlib.sha256).digest()[:HMAC_BYTES]


class VehicleKeys:
    """A key pair for each vehicle, Ed25519."""

    tag_bytes = ED25519_BYTES

    def __init__(self, own: Ed25519PrivateKey, peers: Mapping[str, Ed25519PublicKey]) -> None:
        self._own, self._peers = own, dict(peers)

    def sign(self, packet: LandmarkPacket) -> LandmarkPacket:
        """Return the packet with its tag."""
        return dataclasses.replace(packet, tag=self._own.sign(canonical_bytes(packet)))

    def check(self, packet: LandmarkPacket) -> None:
        """Raise InvalidMessage with reason unsigned or signature, unless the vehicle that it names has signed it."""
        _require_tag(packet)
        key = self._peers.get(packet.vehicle)
        if key is None:
            raise InvalidMessage("signature", f"no public key of {packet.vehicle!r}")
        try:
            key.verify(packet.tag, canonical_bytes(packet))
        except InvalidSignature:
            detail = f"packet {packet.sequence} of {packet.source} is not signed by {packet.vehicle}"
            raise InvalidMessage("signature", detail) from None


def _require_tag(packet: LandmarkPacket) -> None:
    if not packet.tag:
        raise InvalidMessage("unsigned", f"packet {packet.sequence} of {packet.source} has no tag")


def authentication_for(vehicle: str, config: FusionConfig) -> Authentication:
    """Return the authentication that is configured.

    Raises:
        ConfigError: a key can't be read, or the vehicle's own pair does not match.
    """
    if config.fleet_key_file:
        return FleetKey(_fleet_key(expanded(config.fleet_key_file, "fusion.fleet_key_file")))
    if config.signing_key_file:
        own = _private_key(expanded(config.signing_key_file, "fusion.signing_key_file"))
        peers = _public_keys(expanded(config.peer_keys_folder, "fusion.peer_keys_folder"))
        if vehicle in peers and peers[vehicle].public_bytes_raw() != own.public_key().public_bytes_raw():
            raise ConfigError(f"{config.signing_key_file} is not the key of {vehicle} in {config.peer_keys_folder}")
        return VehicleKeys(own, peers)
    return NoAuthentication()


def _fleet_key(path: Path) -> bytes:
    key = _read(path)
    if len(key) < MIN_KEY_BYTES:
        raise ConfigError(f"{path}: a key of {len(key)} bytes; use {MIN_KEY_BYTES} random bytes or more")
    return key


def _private_key(path: Path) -> Ed25519PrivateKey:
    try:
        key = load_pem_private_key(_read(path), password=None)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path}: no private key without password in PEM ({error})") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise ConfigError(f"{path}: not an Ed25519 key; make one with openssl genpkey -algorithm ed25519")
    return key


def _public_keys(folder: Path) -> dict[str, Ed25519PublicKey]:
    """Read <vehicle>.pem of every vehicle."""
    keys = {}
    for path in sorted(folder.glob("*.pem")):
        try:
            key = load_pem_public_key(_read(path))
        except ValueError as error:
            raise ConfigError(f"{path}: no public key in PEM ({error})") from None
        if not isinstance(key, Ed25519PublicKey):
            raise ConfigError(f"{path}: not an Ed25519 key")
        keys[path.stem] = key
    if not keys:
        raise ConfigError(f"{folder}: no public keys; put <vehicle>.pem of every vehicle there")
    return keys


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: the key can't be read ({error.strerror})") from None
