# SPDX-License-Identifier: Apache-2.0
"""Reads and sets a flying vehicle's communication mode, a parameter of its fusion node."""

import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters

from uav_vslam.errors import UavVslamError
from uav_vslam.ros.topic_tools import Observer

MODE = "fusion.mode"
ASK_AGAIN_S = 2.0  # a node that has not discovered the asking one yet drops its answer (rmw_fastrtps, after 0.1 s)


def current_mode(node: Observer, vehicle: str, *, wait_s: float) -> str:
    """Return a vehicle's mode.

    Raises:
        UavVslamError: it does not answer.
    """
    answer = _call(node, vehicle, GetParameters, "get_parameters", GetParameters.Request(names=[MODE]), wait_s)
    return str(answer.values[0].string_value)


def switch_mode(node: Observer, vehicle: str, mode: str, *, wait_s: float) -> None:
    """Set a vehicle's mode.

    Raises:
        UavVslamError: it does not answer, or refuses.
    """
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=mode)
    request = SetParameters.Request(parameters=[Parameter(name=MODE, value=value)])
    result = _call(node, vehicle, SetParameters, "set_parameters", request, wait_s).results[0]
    if not result.successful:
        raise UavVslamError(f"{vehicle} keeps its mode: {result.reason}")


def _call(node: Observer, vehicle: str, kind: Any, name: str, request: Any, wait_s: float) -> Any:
    service = f"/{vehicle}/fusion/{name}"
    client = node.create_client(kind, service)
    try:
        if not node.spin_until(client.service_is_ready, wait_s):
            raise UavVslamError(
                f"{service} is not there; is {vehicle} flying, on this domain, and not with --no-parameter-services?"
            )
        end_s = time.monotonic() + wait_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            answer = client.call_async(request)
            if node.spin_until(answer.done, min(ASK_AGAIN_S, left_s)):
                return answer.result()
            client.remove_pending_request(answer)
        raise UavVslamError(f"{service} did not answer within {wait_s:g} s; is its node alive?")
    finally:
        node.destroy_client(client)
