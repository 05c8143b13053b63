# SPDX-License-Identifier: Apache-2.0
"""Makes and checks the keys of `cooperation.authentication`."""

import dataclasses
import hashlib
import os
import secrets
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from uav_vslam.config import FleetConfig, FusionConfig, expanded
from uav_vslam.cooperation.authentication import authentication_for
from uav_vslam.errors import ConfigError

KEY_BYTES = 32
OWNER_ONLY = 0o600
VEHICLE_KEYS = "one each"


@dataclass(frozen=True, slots=True)
class KeyReport:
    """The key of one vehicle.

    Attributes:
        vehicle: its name.
        file: its key file; empty for none.
        fingerprint: start of the SHA-256 of the file, to compare computers; empty if there is no key.
        fault: what is wrong, or nothing.
    """

    vehicle: str
    file: str
    fingerprint: str = ""
    fault: str = ""


def new_key(path: Path) -> str:
    """Write a new fleet key, readable by its owner only, and return its fingerprint.

    Raises:
        ConfigError: there is a file already, or it can't be written.
    """
    key = secrets.token_bytes(KEY_BYTES)
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, OWNER_ONLY), "wb") as file:
            file.write(key)
    except FileExistsError:
        raise ConfigError(f"{path} exists; remove it first if the whole fleet is to have a new key") from None
    except OSError as error:
        raise ConfigError(f"{path}: the key can't be written ({error.strerror})") from None
    return fingerprint(key)


def fingerprint(key: bytes) -> str:
    """Return what distinguishes one key from another, and reveals nothing about it."""
    return hashlib.sha256(key).hexdigest()[:16]


def check_keys(fleet: FleetConfig, vehicles: Collection[str]) -> list[KeyReport]:
    """Check the keys of vehicles, of all if none is named, as far as their files are on this computer.

    Raises:
        ConfigError: a vehicle is not in the fleet.
    """
    fusion = {name: config.fusion for name, config in fleet.chosen(vehicles).items()}
    reports = [_report(name, one) for name, one in fusion.items()]
    found = [one for one in reports if one.fingerprint]
    kinds = {one.fingerprint if fusion[one.vehicle].fleet_key_file else VEHICLE_KEYS for one in found}
    differ = "" if len(kinds) < 2 else "the vehicles have different keys: copy one file to all"
    return [one if one.fault else dataclasses.replace(one, fault=differ) for one in reports]


def without_key(fleet: FleetConfig) -> list[str]:
    """Return the vehicles that cooperate with others and have no key."""
    fusion = {name: config.fusion for name, config in fleet.vehicles.items()}
    alone = len(fusion) < 2
    return [name for name, one in fusion.items() if not (alone or one.mode == "none" or _key_file(one))]


def _key_file(fusion: FusionConfig) -> str:
    return fusion.fleet_key_file or fusion.signing_key_file


def _report(vehicle: str, fusion: FusionConfig) -> KeyReport:
    file = _key_file(fusion)
    if not file:
        return KeyReport(vehicle, "", fault="no key (fusion.fleet_key_file, or fleet_key in the fleet file)")
    try:
        authentication_for(vehicle, fusion)
        path = expanded(file, "key")
    except ConfigError as error:
        return KeyReport(vehicle, file, fault=str(error))
    mode = path.stat().st_mode & 0o777
    readable = f"others may read it (mode {mode:o}): chmod 600 {path}" if mode & 0o077 else ""
    return KeyReport(vehicle, file, fingerprint(path.read_bytes()), readable)
