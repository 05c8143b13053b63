# SPDX-License-Identifier: Apache-2.0
"""The radio's own domain: a second context with one bare node, the only participant that other vehicles discover.

Neither parameters nor logs nor the vehicle's other topics are announced there. See docs/radio.md.
"""

from collections.abc import Sequence

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import get_default_context

from uav_vslam.config.nodes import FusionNodeConfig
from uav_vslam.errors import ConfigError
from uav_vslam.ros.params import read
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.ros.transport import DISCOVERY_RANGE, STATIC_PEERS, environment

POLL_S = 0.05  # period of serving the second context: packets come once a second
CALLBACKS_A_TURN = 4


def open_participant(name: str, args: list[str] | None) -> "Participant | None":
    """Open the radio by the parameters of the node of that name, before the node itself opens its domain.

    The first participant of a process has the port that peers look for, so a temporary node reads the
    parameters first. They are `radio_domain_id` (-1: the radio shares the vehicle's domain) and `radio_peers`.

    Args:
        name: of the node.
        args: command line; None for that of the process.

    Raises:
        ConfigError: a parameter is wrong.
    """
    own, namespace = _parameters(name, args)
    if own.radio_domain_id < 0:
        if own.radio_peers:
            raise ConfigError("radio_peers are addresses on the radio's ROS domain; set radio_domain_id as well")
        return None
    if own.radio_domain_id == get_default_context().get_domain_id():  # its first port may be another node's
        raise ConfigError(
            f"radio_domain_id = {own.radio_domain_id} is the vehicle's own ROS domain (ROS_DOMAIN_ID, --domain); "
            "the radio needs another, the same on all computers"
        )
    try:
        return Participant(namespace, own.radio_domain_id, own.radio_peers)
    except rclpy_implementation.RCLError as error:
        if "resolve peer" not in str(error):
            raise
        text = str(error).partition("\n")[0]
        raise ConfigError(f"radio_peers = {list(own.radio_peers)}: {text}; use addresses, like 10.77.0.2") from None


def _parameters(name: str, args: list[str] | None) -> tuple[FusionNodeConfig, str]:
    """Return a node's own parameters and its namespace.

    Whatever a node needs to read them joins no domain: a participant that leaves while others come or go may hang (see
    `leaving`).
    """
    context = Context()
    with environment({DISCOVERY_RANGE: "OFF"}):
        context.init(args=args)
    reader = Node(name, context=context, enable_rosout=False, start_parameter_services=False)
    try:
        return read(reader, FusionNodeConfig), reader.get_namespace()
    finally:
        reader.destroy_node()
        context.try_shutdown()


class Participant:
    """A bare node in a context and domain of its own, spun by a timer of the vehicle's node."""

    def __init__(self, namespace: str, domain_id: int, addresses: Sequence[str]) -> None:
        """Open it.

        Args:
            namespace: of the vehicle.
            domain_id: of the radio.
            addresses: of the other vehicles on the radio; the DDS profile decides whether multicast finds more.
        """
        self._context = Context()
        with environment({DISCOVERY_RANGE: "SUBNET", STATIC_PEERS: ";".join(addresses)}):
            self._context.init(args=[], domain_id=domain_id)  # the process's arguments are for the vehicle's node
        self.node = Node(
            "radio",
            context=self._context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        for publisher in list(self.node.publishers):  # of parameter events: it would be announced to everyone
            self.node.destroy_publisher(publisher)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def serve(self, owner: Node) -> None:
        """Let a node's executor serve this one too."""
        create_wall_timer(owner, POLL_S, self._spin)

    def close(self) -> None:
        """Leave the radio."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        for _ in range(CALLBACKS_A_TURN):
            self._executor.spin_once(timeout_sec=0.0)
