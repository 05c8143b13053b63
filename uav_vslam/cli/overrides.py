# SPDX-License-Identifier: Apache-2.0
"""Settings given on the command line, as `backend.sigma_px=0.5`."""

from collections.abc import Iterable


def overrides(items: Iterable[str]) -> dict[str, object]:
    """Return values by dotted name.

    Raises:
        ConfigError: one is not of that form, or its value is not YAML.
    """
    return dict(map(_override, items))


def _override(item: str) -> tuple[str, object]:
    import yaml

    from uav_vslam.errors import ConfigError

    key, separator, value = item.partition("=")
    if not separator:
        raise ConfigError(f"setting {item!r} must have the form KEY=VALUE, for example backend.sigma_px=0.5")
    try:
        return key, yaml.safe_load(value)
    except (yaml.YAMLError, ValueError):  # ValueError: what looks like a date and is none
        raise ConfigError(f"setting {item!r}: the value is not YAML; quote it, or close its brackets") from None
