# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the configuration classes: names, types, ranges and texts have their one home in `config`."""

import contextlib
import json
import math
import typing
from collections.abc import Callable, Mapping
from pathlib import Path

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from uav_vslam.config import VehicleConfig
from uav_vslam.config.nodes import NODES
from uav_vslam.config.settings import (
    Setting,
    Settings,
    all_settings,
    build,
    check_names,
    flatten,
    plain,
    refuse,
    replaced,
)
from uav_vslam.datasets.sensor_setup import with_noise_of_files
from uav_vslam.errors import ConfigError
from uav_vslam.slam.state_folder import replace_file

Config = typing.TypeVar("Config", bound=Settings)

QOS_OVERRIDES = "qos_overrides."
OF_ROS = ("use_sim_time", "start_type_description_service", QOS_OVERRIDES)  # prefixes of names that are not ours
QOS_CHOICES: Mapping[str, type[HistoryPolicy] | type[ReliabilityPolicy]] = {
    "history": HistoryPolicy,
    "reliability": ReliabilityPolicy,
}
LARGEST_INTEGER = 2**63 - 1


def read(node: Node, cls: type[Config]) -> Config:
    """Return a configuration from what the command line and parameter files set for a node.

    Raises:
        ConfigError: a name that no node of ours has, or a value of this class that is not allowed.
    """
    where = f"parameters of {node.get_fully_qualified_name()}"
    # rclpy hands them out one by one only, by known names
    every = {name: _given(parameter) for name, parameter in node._parameter_overrides.items()}
    _check_qos(every, where)
    given = {name: value for name, value in every.items() if not name.startswith(OF_ROS)}
    check_names(given, VehicleConfig, *(parameters.own for parameters in NODES.values()), where=where)
    names = all_settings(cls)
    return build(cls, {name: value for name, value in given.items() if name in names}, where=where)


def declare(node: Node, config: Settings, names: typing.Iterable[str] | None = None) -> None:
    """Declare settings of a configuration, all by default, each with its text, unit and range."""
    settings, values = all_settings(type(config)), flatten(config)
    for name in settings if names is None else names:
        value = plain(values[name])
        if value != []:
            node.declare_parameter(name, value, _descriptor(settings[name]), ignore_override=True)
            continue
        # rclpy finds no type in an empty list, and of all that are asked for answers none if one has no value
        kind = Parameter.Type.DOUBLE_ARRAY if settings[name].kind == tuple[float, ...] else Parameter.Type.STRING_ARRAY
        node.declare_parameter(name, kind, _descriptor(settings[name]), ignore_override=True)
        node._parameters[name] = Parameter(name, kind, value)


def _given(parameter: Parameter) -> object:
    """Return a value that was set at the start; an empty list, for which ROS has no type, comes without one."""
    return [] if parameter.type_ == Parameter.Type.NOT_SET else parameter.value


class VehicleParameters:
    """The settings of a vehicle that one of its nodes uses; live ones follow `ros2 param set`.

    Attributes:
        config: the current one. Settings of sections that the node does not use keep their initial values.
    """

    def __init__(self, node: Node, names: typing.Iterable[str], on_change: Callable[[VehicleConfig], None]) -> None:
        """Declare.

        Args:
            node: reads them from its command line and parameter files.
            names: settings that it uses.
            on_change: called with the configuration after live settings have changed.

        Raises:
            ConfigError: an unknown name, or a value that is not allowed.
        """
        self.config = with_noise_of_files(read(node, VehicleConfig))
        self._launched = flatten(self.config)
        self._file: Path | None = None
        self._node, self._on_change = node, on_change
        settings = all_settings(VehicleConfig)
        self._settings: Mapping[str, Setting] = {name: settings[name] for name in names}
        declare(node, self.config, self._settings)
        node.add_pre_set_parameters_callback(self._converted)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def keep_live(self, path: Path, *, resume: bool) -> None:
        """Keep live settings in a file from their first change on; `resume` takes over what a process that died left.

        Call it before the node uses the configuration.
        """
        self._file = path
        if resume:
            self._take_over(path)
            return
        with contextlib.suppress(OSError):
            path.unlink()

    def _take_over(self, path: Path) -> None:
        log = self._node.get_logger()
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            changes = {name: value for name, value in values.items() if self._settings[name].live}
            self.config = replaced(self.config, changes, where=str(path))
        except FileNotFoundError:  # nothing was changed
            return
        except (OSError, ValueError, KeyError, AttributeError, ConfigError) as error:
            log.warning(f"{path}: live settings of the process before can't be taken over ({error})")
            return
        self._node.set_parameters([Parameter(name, value=value) for name, value in changes.items()])
        log.warning(f"live settings as the process before had them: {changes}")

    def _save_live(self) -> None:
        if self._file is None:
            return
        values = flatten(self.config)
        changed = {name: plain(values[name]) for name in self._settings if values[name] != self._launched[name]}
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            replace_file(self._file, json.dumps(changed).encode(), durable=False)
        except OSError as error:
            self._node.get_logger().warning(
                f"{self._file}: live settings can't be stored ({error.strerror}); a restart of this node forgets them"
            )

    def _converted(self, parameters: list[Parameter]) -> list[Parameter]:
        """Give values their declared types: `ros2 param set` sends 1 as an integer and 1e-3 as a text."""
        return [self._as_declared(one) for one in parameters]

    def _as_declared(self, given: Parameter) -> Parameter:
        try:
            return Parameter(given.name, value=plain(self._settings[given.name].accepted(given.value)))
        except (KeyError, ValueError):
            return given  # refused later, with the reason

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._with(parameters)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        before, self.config = self.config, self._with(parameters)
        if self.config != before:
            self._save_live()
            self._on_change(self.config)

    def _with(self, parameters: list[Parameter]) -> VehicleConfig:
        changes = {one.name: one.value for one in parameters if one.name in self._settings}
        if not changes:  # as for each QoS override that a topic declares
            return self.config
        return replaced(self.config, changes, where=self._node.get_fully_qualified_name())


def _check_qos(given: Mapping[str, object], where: str) -> None:
    """Refuse values of qos_overrides.* that rclpy would fail on."""
    for name, value in given.items():
        policy = name.rpartition(".")[2]
        if not name.startswith(QOS_OVERRIDES) or policy not in (*QOS_CHOICES, "depth"):
            continue
        choices = [one.name.lower() for one in QOS_CHOICES.get(policy, ()) if one.name != "UNKNOWN"]
        if choices and str(value).lower() not in choices:
            refuse(f"{where}: {name}", value, f"one of {', '.join(choices)}")
        if not choices and (type(value) is not int or value < 1):
            refuse(f"{where}: {name}", value, "a whole number of at least 1")


def _descriptor(described: Setting) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=described.description,
        additional_constraints=described.range,
        read_only=not described.live,
    )
    lowest = described.above if described.at_least is None else described.at_least
    highest = described.below if described.at_most is None else described.at_most
    if lowest is None and highest is None:
        return descriptor
    if described.kind is int:
        bounds = int(lowest or 0), LARGEST_INTEGER if highest is None else int(highest)
        descriptor.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1])]
    else:
        from_value, to_value = -math.inf if lowest is None else lowest, math.inf if highest is None else highest
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(from_value), to_value=float(to_value))]
    return descriptor
