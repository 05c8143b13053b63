# SPDX-License-Identifier: Apache-2.0
"""Configuration keys given on the command line, as `backend.sigma_px=0.5`."""


def override(item: str) -> tuple[str, object]:
    """Return key and value of one.

    Raises:
        ConfigError: it is not of that form, or the value is not YAML.
    """
    import yaml

    from uav_vslam.errors import ConfigError

    key, separator, value = item.partition("=")
    if not separator:
        raise ConfigError(f"setting {item!r} must have the form KEY=VALUE, for example backend.sigma_px=0.5")
    try:
        return key, yaml.safe_load(value)
    except yaml.YAMLError:
        raise ConfigError(f"setting {item!r}: the value is not YAML; quote it, or close its brackets") from None
