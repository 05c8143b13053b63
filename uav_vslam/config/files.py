# SPDX-License-Identifier: Apache-2.0
"""Reading and writing configuration files.

Vehicles and links have ROS parameter files, which hold differences only and also go to `--params-file`:

    /**:
      ros__parameters:
        backend:
          sigma_px: 0.5

An unknown key, a wrong type or a value out of range raises `ConfigError` that names the file, the key and the remedy.
"""

import dataclasses
import difflib
import ipaddress
import os
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.config.fleet import FleetConfig, LinkConfig, RadioConfig, ReplayConfig
from uav_vslam.config.fusion import FusionConfig
from uav_vslam.config.nodes import LinkNodeConfig
from uav_vslam.config.settings import build, differences, flatten, flattened, is_vehicle_name, plain
from uav_vslam.config.vehicle import VehicleConfig
from uav_vslam.errors import ConfigError, one_line
from uav_vslam.yaml_text import Loader, parse_yaml

ALL_NODES, PARAMETERS = "/**", "ros__parameters"
CALIBRATION = "input.calibration"
PATHS = "start.map", "fusion.fleet_key_file", "fusion.signing_key_file", "fusion.peer_keys_folder"


def find_config(name: str) -> Path:
    """Return the file of a configuration: a path, or the name of a file in this project's `config` folder.

    Raises:
        ConfigError: there is neither.
    """
    return _find(name, "configuration", _folders())


def _find(name: str, kind: str, folders: Sequence[Path]) -> Path:
    for candidate in (Path(name), *(folder / f"{name.removesuffix('.yaml')}.yaml" for folder in folders)):
        if candidate.is_file():
            return candidate
    files = [file for folder in folders for file in folder.glob("*.yaml") if ALL_NODES in read_yaml(file)]
    known = ", ".join(sorted({file.stem for file in files}))  # no fleet files
    raise ConfigError(f"{kind} {name!r} is neither a file nor one of ours ({known})")


def find_dds_profile(name: str) -> Path:
    """Return a file of `config/dds`.

    Raises:
        ConfigError: it is not installed.
    """
    for folder in _folders():
        if (folder / "dds" / name).is_file():
            return folder / "dds" / name
    raise ConfigError(f"{name} is not in {_folders()[0] / 'dds'}; is the package installed completely?")


def _folders() -> list[Path]:
    """Return where this project's `config` folder may be: in the repository, or installed."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    installed = [Path(prefix) / "share/uav_vslam/config" for prefix in prefixes]
    return [Path(__file__).resolve().parents[2] / "config", *installed]


def load_vehicle(path: Path | None, *, overrides: Mapping[str, Any] | None = None) -> VehicleConfig:
    """Read a vehicle's parameter file; keys that are absent keep their defaults.

    Args:
        path: YAML file, or None for pure defaults.
        overrides: {"backend.sigma_px": 0.5, ...}, applied last.

    Raises:
        ConfigError: the file can't be read, or a key or value is wrong.
    """
    values = {} if path is None else _beside(_read_parameters(path), path)
    try:
        return build(VehicleConfig, values | dict(overrides or {}), where=str(path or "overrides"))
    except ConfigError:
        if path is None or not overrides:
            raise
        build(VehicleConfig, values, where=str(path))  # a fault of the file is the one to name
        return build(VehicleConfig, values | dict(overrides), where=f"overrides of {path}")


def load_resolved(path: Path) -> dict[str, VehicleConfig]:
    """Read the `config.yaml` of a results folder: the resolved configuration of each vehicle, by name.

    Raises:
        ConfigError: the file can't be read, or a key or value is wrong.
    """
    found = {}
    for nodes, inner in read_yaml(path).items():
        name = str(nodes).removeprefix("/").removesuffix(ALL_NODES)
        if not isinstance(inner, dict) or not isinstance(inner.get(PARAMETERS), dict):
            raise ConfigError(f"{path}: {nodes!r} holds no '{PARAMETERS}:'; name a folder that run or demo wrote")
        found[name] = build(VehicleConfig, dict(flattened(inner[PARAMETERS])), where=str(path))
    return found


def load_link(name: str) -> LinkConfig:
    """Read the parameter file of an emulated radio link: a path, or the name of a file in `config/links`.

    Raises:
        ConfigError: there is neither, the file can't be read, or a key or value is wrong.
    """
    path = _find(name, "link", [folder / "links" for folder in _folders()])
    return build(LinkNodeConfig, _read_parameters(path), where=str(path)).link


def load_fleet(path: Path, *, overrides: Mapping[str, Any] | None = None) -> FleetConfig:
    """Read a fleet file: `vehicles: {uav1: {config: kagaru.yaml}}`, `replay: {bags: [...], rate: 0}`, `mode: wideband`.

    Vehicles with a computer each have an `address`, too, and share `radio: {domain_id: 42, interface: wlan0}`, and
    `fleet_key: fleet.key` is the key of all. Paths are relative to the file; overrides such as
    {"backend.sigma_px": 0.5} reach every vehicle.

    Raises:
        ConfigError: the file can't be read, a key or value is wrong, or a vehicle's name is used twice.
    """
    tree = read_yaml(path)
    if ALL_NODES in tree:
        example = f"vehicles: {{uav1: {{config: {path.name}}}}}"
        raise ConfigError(f"{path} is a vehicle's parameter file; a fleet file beside it names it: {example}")
    _reject_unknown(tree, {"vehicles", "replay", "mode", "radio", "fleet_key"}, where=str(path), prefix="")
    if not isinstance(tree.get("vehicles"), dict) or not tree["vehicles"]:
        raise ConfigError(
            f"{path}: 'vehicles' must map at least one name to its settings, e.g. uav1: {{config: kagaru.yaml}}"
        )
    shared: dict[str, Any] = {}
    if "mode" in tree:
        shared["fusion.mode"] = build(FusionConfig, {"mode": tree["mode"]}, where=str(path)).mode
    shared |= _fleet_key(path, tree["fleet_key"]) if "fleet_key" in tree else {}
    vehicles = {
        name: load_vehicle(_vehicle_file(path, name, entry), overrides={**shared, **(overrides or {})})
        for name, entry in tree["vehicles"].items()
    }
    radio = build(RadioConfig, _section(path, tree, "radio"), where=f"{path}: radio")
    addresses = _addresses(path, tree["vehicles"])
    if addresses and radio.domain_id < 0:
        raise ConfigError(f"{path}: vehicles have addresses on the radio, which has no ROS domain; set radio.domain_id")
    return FleetConfig(vehicles, _replay(path, _section(path, tree, "replay")), radio, addresses)


def parameter_file(configs: Mapping[str, VehicleConfig]) -> dict[str, Any]:
    """Return complete configurations, by node pattern ("/**", "/uav1/**"), as a ROS parameter file."""
    return {nodes: {PARAMETERS: _tree(flatten(config))} for nodes, config in configs.items()}


def difference_file(config: VehicleConfig) -> dict[str, Any]:
    """Return what differs from the defaults as a ROS parameter file for all nodes."""
    return {ALL_NODES: {PARAMETERS: _tree(differences(config))}}


def _tree(values: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *path, key = name.split(".")
        section = tree
        for part in path:
            section = section.setdefault(part, {})
        section[key] = plain(value)
    return tree


def _beside(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a file's values with the paths in it, which are relative to it, as absolute ones."""
    found = {name: _absolute(values[name], path, name) for name in PATHS if values.get(name)}
    if isinstance(paths := values.get(CALIBRATION), list):
        found[CALIBRATION] = [_absolute(one, path, CALIBRATION) for one in paths if one]
    return values | found


def _absolute(given: Any, path: Path, name: str) -> Any:
    """Return a path that a file gives, relative to it, as an absolute one; what is no text is refused later."""
    return str((path.parent / expanded(given, f"{path}: {name}")).resolve()) if isinstance(given, str) else given


def expanded(given: str, name: str) -> Path:
    """Return a path in which ~ and ~user stand for their folders.

    Raises:
        ConfigError: there is no such user; `name` says what the path is of.
    """
    try:
        return Path(given).expanduser()
    except RuntimeError:
        raise ConfigError(f"{name} {given}: there is no such user; name the folder in full") from None


def _vehicle_file(path: Path, name: Any, entry: Any) -> Path | None:
    """Return the parameter file that a fleet file names for a vehicle."""
    if not is_vehicle_name(name):
        raise ConfigError(f"{path}: vehicle name {name!r} must be a valid ROS namespace: letters, digits, underscores")
    entry = entry or {}
    if not (isinstance(entry, dict) and isinstance(entry.get("config") or "", str)):
        raise ConfigError(f"{path}: vehicles.{name} = {entry!r} must look like {{config: kagaru.yaml}}")
    _reject_unknown(entry, {"config", "address"}, where=str(path), prefix=f"vehicles.{name}.")
    return path.parent / entry["config"] if entry.get("config") else None


def _section(path: Path, tree: Mapping[Any, Any], name: str) -> dict[str, Any]:
    """Return the keys and values of a part of a fleet file."""
    values = tree.get(name) or {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: {name} must hold keys and values, not {values!r}")
    return {str(key): value for key, value in values.items()}


def _fleet_key(path: Path, value: Any) -> dict[str, Any]:
    if not isinstance(value, str) or not value:
        raise ConfigError(f"{path}: fleet_key = {value!r} must be the path of a key file; uav-vslam keys new makes one")
    return {"fusion.fleet_key_file": _absolute(value, path, "fleet_key")}


def _addresses(path: Path, entries: Mapping[str, Any]) -> dict[str, str]:
    """Return the vehicles' addresses on the radio."""
    given = {name: entry["address"] for name, entry in entries.items() if entry and "address" in entry}
    for name, address in given.items():
        try:
            ipaddress.ip_address(address)
        except ValueError:
            raise ConfigError(f"{path}: vehicles.{name}.address = {address!r} must be like 10.77.0.1") from None
    missing = sorted(set(entries) - set(given))
    if given and missing:
        raise ConfigError(f"{path}: vehicles have addresses on the radio, but {', '.join(missing)} has none; add it")
    if twice := sorted(name for name, one in given.items() if list(given.values()).count(one) > 1):
        raise ConfigError(f"{path}: {', '.join(twice)} have one address on the radio; each computer has its own")
    return given


def _replay(path: Path, values: dict[str, Any]) -> ReplayConfig:
    replay = build(ReplayConfig, values, where=f"{path}: replay")
    return dataclasses.replace(replay, bags=tuple(path.parent / bag for bag in replay.bags))


def _reject_unknown(keys: Iterable[Any], known: set[str], *, where: str, prefix: str) -> None:
    for key in sorted(map(str, set(keys) - known)):
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean {prefix}{near[0]}?" if near else f"known keys: {', '.join(sorted(known))}"
        raise ConfigError(f"{where}: unknown key {prefix}{key}; {hint}")


def _read_parameters(path: Path) -> dict[str, Any]:
    """Return the values of a ROS parameter file for all nodes by dotted name."""
    tree = read_yaml(path)
    if not tree:
        return {}
    if "vehicles" in tree:
        raise ConfigError(f"{path} is a fleet file: give it to run or launch as what to fly, not as a configuration")
    inner = tree.get(ALL_NODES)
    if set(tree) != {ALL_NODES} or not isinstance(inner, dict) or set(inner) != {PARAMETERS}:
        raise ConfigError(
            f"{path}: must be a ROS parameter file: put everything below '{ALL_NODES}:' and, indented, '{PARAMETERS}:'"
        )
    values = inner[PARAMETERS] or {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: {PARAMETERS} must hold keys and values, not {values!r}")
    flat = list(flattened(values))
    for name, count in Counter(name for name, _ in flat).items():
        if count > 1:
            raise ConfigError(f"{path}: key {name!r} is used twice")
    return dict(flat)


class _UniqueKeyLoader(Loader):
    """Refuses repeated keys, of which YAML silently keeps the last: a vehicle named twice must not be lost."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            fault = "must be a word" if not isinstance(key, Hashable) else "is used twice" if key in seen else ""
            if fault:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} {fault}", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> dict[Any, Any]:
    """Return the keys and values of a YAML file, none of them twice.

    Raises:
        ConfigError: it can't be read, or is not valid.
    """
    try:
        tree = parse_yaml(path.read_text(encoding="utf-8"), _UniqueKeyLoader)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror}); give the path of a YAML file") from None
    except ValueError as error:  # InvalidYaml, or no text
        raise ConfigError(f"{path}: not valid YAML: {one_line(error)}") from None
    if tree is not None and not isinstance(tree, dict):
        raise ConfigError(f"{path}: must hold keys and values, not {type(tree).__name__}")
    return tree or {}
