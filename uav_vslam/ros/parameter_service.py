# SPDX-License-Identifier: Apache-2.0
"""Services by which others read and change a node's parameters: what can't be set is answered with the reason.

rclpy's own raise at a type that does not exist, which ends the node, and refuse an unknown name without naming it.
"""

import difflib
from typing import Any

from rcl_interfaces.msg import ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter_service import ParameterService

LAST_TYPE = ParameterType.PARAMETER_STRING_ARRAY


class AnsweringParameterService(ParameterService):
    """The parameter services of one node."""

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        for one in request.parameters:
            alone = SetParametersAtomically.Request(parameters=[one])
            answer = self._set_parameters_atomically_callback(alone, SetParametersAtomically.Response())
            response.results.append(answer.result)
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        refusals = [refusal for one in request.parameters if (refusal := self._refusal(one))]
        if refusals:
            response.result = SetParametersResult(successful=False, reason="; ".join(refusals))
            return response
        return super()._set_parameters_atomically_callback(request, response)

    def _refusal(self, asked: Any) -> str:
        """Return why rclpy could not even look at a parameter; normally empty."""
        node = self._get_node()
        if asked.value.type > LAST_TYPE:
            return f"{asked.name}: there is no type {asked.value.type}; use one of rcl_interfaces/msg/ParameterType"
        if node.has_parameter(asked.name):
            return ""
        near = difflib.get_close_matches(asked.name, list(node._parameters), n=1)
        hint = f"did you mean {near[0]}?" if near else "`ros2 param list` shows those it has"
        return f"{node.get_fully_qualified_name()} has no parameter {asked.name!r}; {hint}"
