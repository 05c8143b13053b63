# SPDX-License-Identifier: Apache-2.0
"""Settings given on the command line, as `backend.sigma_px=0.5`."""

from collections.abc import Iterable


def overrides(items: Iterable[str]) -> dict[str, object]:
    """Return values by dotted name.

    Raises:
        ConfigError: one is not of that form, its value is not YAML, or two give values to one setting.
    """
    from uav_vslam.errors import ConfigError

    found: dict[str, object] = {}
    for key, value in map(_override, items):
        if key in found:
            raise ConfigError(f"setting {key} is given twice, {found[key]} and {value}, and only one can count")
        found[key] = value
    return found


def _override(item: str) -> tuple[str, object]:
    from uav_vslam.errors import ConfigError, InvalidYaml
    from uav_vslam.yaml_text import parse_yaml

    key, separator, value = item.partition("=")
    if not separator:
        raise ConfigError(f"setting {item!r} must have the form KEY=VALUE, for example backend.sigma_px=0.5")
    try:
        return key, parse_yaml(value)
    except InvalidYaml as error:
        raise ConfigError(
            f"setting {item!r}: the value is not YAML: {error}; quote it, or close its brackets"
        ) from None
