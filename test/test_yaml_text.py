# SPDX-License-Identifier: Apache-2.0
"""Whatever is wrong with a YAML text is one error that names the line."""

import pytest

from uav_vslam.errors import InvalidYaml
from uav_vslam.yaml_text import parse_yaml

FAULTS = {
    "no date": ("2024-13-45", r"'2024-13-45' is no timestamp \(month must be in 1\.\.12\) \(line 2\)"),
    "no hour": ("2024-01-01T25:00:00", r"is no timestamp \(hour must be in 0\.\.23\) \(line 2\)"),
    "no hexadecimal number": ("0x_", r"'0x_' is no int .* \(line 2\)"),
    "no binary number": ("0b_", r"'0b_' is no int .* \(line 2\)"),
    "too many digits": ("9" * 5000, r"is no int .* \(line 2\)"),
    "no boolean": ("!!bool maybe", r"'maybe' is no bool .* \(line 2\)"),
    "no time": ("!!timestamp noon", r"'noon' is no timestamp .* \(line 2\)"),
    "open bracket": ("[1, 2", r"expected ',' or '\]', .* \(line 2\)"),
    "list as a key": ("{[1, 2]: 3}", r"unhashable key \(line 2\)"),
    "unknown tag": ("!!python/object:os.system {}", r"constructor for the tag .* \(line 2\)"),
    "part of itself": ("&x [*x]", r"recursive node \(line 2\)"),
    "deep": ("[" * 5000, "nested too deeply"),
    "control character": ("\0", "special characters are not allowed"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_names_its_line(name: str) -> None:
    value, reason = FAULTS[name]
    with pytest.raises(InvalidYaml, match=reason) as refused:
        parse_yaml(f"fine: 1\nkey: {value}")
    assert "\n" not in str(refused.value)


def test_what_is_fine_is_read_and_nothing_is_nothing() -> None:
    assert parse_yaml("a: {b: [1, 2.5, x], c: &one {d: true}, e: *one}") == {
        "a": {"b": [1, 2.5, "x"], "c": {"d": True}, "e": {"d": True}}
    }
    assert parse_yaml("") is None
