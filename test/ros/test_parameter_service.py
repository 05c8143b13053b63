# SPDX-License-Identifier: Apache-2.0
"""Whatever is asked of the parameter services, over DDS, is answered, and the node goes on."""

from array import array
from pathlib import Path
from typing import Any

import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue, SetParametersResult  # noqa: E402
from rcl_interfaces.srv import (  # noqa: E402
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import parameter_value_to_python  # noqa: E402

from uav_vslam.config import VehicleConfig  # noqa: E402
from uav_vslam.ros.params import read  # noqa: E402
from uav_vslam.ros.stereo_frontend_node import StereoFrontendNode  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros
NEAREST = "frontend.min_depth_m"


class Operator:
    """Somebody else on the domain, who sets parameters of a front end."""

    def __init__(self, domain_id: int) -> None:
        rclpy.init(args=["--ros-args", "-r", "__ns:=/uav1"], domain_id=domain_id)
        self.front, self._node = StereoFrontendNode(), rclpy.create_node("operator")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.front)
        self._executor.add_node(self._node)

    def call(self, kind: Any, service: str, **request: Any) -> Any:
        client = self._node.create_client(kind, f"stereo_frontend/{service}")
        assert wait_for(client.service_is_ready, self._turn)
        future = client.call_async(kind.Request(**request))
        assert wait_for(future.done, self._turn)
        return future.result()

    def set(self, *parameters: Parameter) -> list[SetParametersResult]:
        return list(self.call(SetParameters, "set_parameters", parameters=parameters).results)

    def set_together(self, *parameters: Parameter) -> SetParametersResult:
        return self.call(SetParametersAtomically, "set_parameters_atomically", parameters=parameters).result

    def value(self) -> float:
        return float(self.call(GetParameters, "get_parameters", names=[NEAREST]).values[0].double_value)

    def _turn(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)

    def leave(self) -> None:
        self.front.destroy_node()
        self._node.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def operator(domain_id: int) -> Any:
    made = Operator(domain_id)
    yield made
    made.leave()


def asked(name: str, value: float, kind: int = ParameterType.PARAMETER_DOUBLE) -> Parameter:
    return Parameter(name=name, value=ParameterValue(type=kind, double_value=value))


def test_a_parameter_that_a_node_does_not_have_is_named_with_the_nearest(operator: Operator) -> None:
    misspelt, unlike = operator.set(asked("frontend.min_dept_m", 1.0), asked("", 1.0))
    assert not misspelt.successful
    assert "no parameter 'frontend.min_dept_m'; did you mean frontend.min_depth_m?" in misspelt.reason
    assert not unlike.successful
    assert "no parameter ''" in unlike.reason


def test_a_type_that_does_not_exist_is_refused(operator: Operator) -> None:
    strange, right = operator.set(asked(NEAREST, 1.0, kind=42), asked(NEAREST, 2.0))
    assert "there is no type 42" in strange.reason
    assert right.successful
    assert operator.value() == 2.0


def test_all_parameters_are_read_at_once_and_start_another_node(operator: Operator, tmp_path: Path) -> None:
    """As `ros2 param dump` does, and a parameter file with what it has written."""
    names = operator.call(ListParameters, "list_parameters").result.names
    values = operator.call(GetParameters, "get_parameters", names=names).values
    assert "input.calibration" in names  # which is empty
    dumped = {name: parameter_value_to_python(value) for name, value in zip(names, values, strict=True)}
    file = tmp_path / "dumped.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {k: _plain(v) for k, v in dumped.items()}}}))
    again = rclpy.create_node("again", cli_args=["--ros-args", "--params-file", str(file)])
    try:
        assert read(again, VehicleConfig) == operator.front.config
    finally:
        again.destroy_node()


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, array) else value


def test_of_parameters_that_are_set_together_all_are_set_or_none(operator: Operator) -> None:
    before = operator.value()
    for wrong in (asked("nonsense", 1.0), asked(NEAREST, 1.0, kind=42), asked("vehicle", 1.0)):
        result = operator.set_together(asked(NEAREST, 3.0), wrong)
        assert not result.successful
        assert result.reason
    assert operator.value() == before
    assert operator.set_together(asked(NEAREST, 3.0)).successful
    assert operator.value() == 3.0
