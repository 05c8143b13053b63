# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process: ROS initialised, the node spun until a signal, and shut down."""

import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from uav_vslam.errors import ConfigError, UavVslamError, one_line
from uav_vslam.memory import keep_freed_memory
from uav_vslam.processes import ending_signals
from uav_vslam.ros.domain import check_domain
from uav_vslam.ros.executor import LeanExecutor
from uav_vslam.ros.idle_qos import warn_of_idle_qos
from uav_vslam.ros.leaving import leaving
from uav_vslam.ros.log_folder import log_folder
from uav_vslam.ros.transport import environment, udp_alone


def run_node(
    factory: Callable[[], Node],
    args: list[str] | None = None,
    *,
    shared_memory: bool = False,
    executor_type: type[Executor] = LeanExecutor,
) -> int:
    """Initialise ROS, spin one node until SIGINT, SIGTERM or SIGHUP, and shut down; return the exit code.

    With --help, print what the node's module says instead. A node may end itself by raising SystemExit in a callback,
    and what it has to `finish` comes before it is destroyed. An error of ours is one line and exit code 2.

    Args:
        factory: makes the node.
        args: command line; None for that of the process.
        shared_memory: whether it may use it, for images; see `transport`.
        executor_type: which executor spins it.
    """
    if args is None and {"-h", "--help"} & set(sys.argv):
        print(_help(factory))
        return 0
    keep_freed_memory()
    cv2.setNumThreads(1)  # several nodes share the cores, and results must not depend on their number
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True  # only this: the signal may interrupt rclpy while it holds a lock that its shutdown needs

    for number in ending_signals():
        signal.signal(number, stop)
    node = executor = None
    code = 1  # of an error that nobody expects
    try:
        with environment({} if shared_memory else udp_alone()):
            _initialise(args)
            node = _made(factory)
        warn_of_idle_qos(node)
        executor = executor_type()
        executor.add_node(node)
        while not stopping:  # each node has a timer on wall time, which ends the wait
            executor.spin_once()
        code = 0
    except (UavVslamError, ParameterException) as error:
        name = node.get_fully_qualified_name().strip("/") if node is not None else "uav_vslam"
        print(f"{name}: {error}", file=sys.stderr)
        code = 2
    except SystemExit as ending:
        code = int(ending.code or 0)
    finally:
        if executor is not None:
            executor.shutdown(timeout_sec=0)  # the garbage collector may otherwise destroy its parts before itself
        code = finish(node) or code
        with leaving(code):
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return code


def finish(node: Node | None) -> int:
    """Let a node finish what it has to before it is destroyed, as saving a map; return the exit code."""
    own: Callable[[], int] = getattr(node, "finish", int)
    return own()


def _help(factory: Callable[[], Node]) -> str:
    return (
        f"usage: {Path(sys.argv[0]).name} --ros-args [-r __ns:=/VEHICLE] [--params-file FILE.yaml] [-p NAME:=VALUE] "
        f"[-r TOPIC:=OTHER]\n\n{(sys.modules[factory.__module__].__doc__ or '').strip()}\n\n"
        "parameters: docs/reference/parameters.md"
    )


def _made(factory: Callable[[], Node]) -> Node:
    """Make the node.

    Raises:
        ConfigError: a parameter names a topic, or a vehicle of which one is made, that ROS can't have.
    """
    try:
        return factory()
    except NameValidationException as error:
        raise ConfigError(f"{one_line(error)}; correct the parameter or remapping that names it") from None
    except rclpy_implementation.RCLError as error:
        if "resolve name" not in str(error):
            raise
        text = one_line(error).partition(", at /")[0]
        raise ConfigError(f"{text}; correct the topics and vehicles that parameters name") from None


def _initialise(args: list[str] | None) -> None:
    """Initialise ROS.

    Raises:
        ConfigError: an argument is unknown, it or a parameter file can't be parsed, logs can't be kept, or there is no
            such domain.
    """
    check_domain(None)
    rcl = rclpy.logging.get_logger("rcl")
    rcl.set_level(LoggingSeverity.FATAL)  # it would say on a line of its own that it can't
    try:
        with log_folder():
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        text = re.sub(r"(, at \S+\.c\w*:\d+|\s)+", lambda found: " " if found[0].isspace() else "", str(error))
        raise ConfigError(f"{text.strip()}; correct the command line or the file that it names") from None
    rcl.set_level(LoggingSeverity.UNSET)
    others = remove_ros_args(sys.argv if args is None else ["", *args])[1:]
    if others:
        raise ConfigError(f"unknown argument {others[0]}: those of ROS follow --ros-args (--help)")
