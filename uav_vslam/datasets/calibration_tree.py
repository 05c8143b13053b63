# SPDX-License-Identifier: Apache-2.0
"""The YAML of calibration files, as it is or as OpenCV's `FileStorage` writes it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.errors import CalibrationError, InvalidYaml
from uav_vslam.yaml_text import Loader, parse_yaml

Tree = Mapping[str, Any]


class _Loader(Loader):
    """Reads OpenCV's matrices as what they consist of: rows, cols, dt and data."""


def _matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def read_tree(path: Path) -> Tree:
    """Return the content of a file; errors as `yaml_tree`, and of a file that can't be read."""
    try:
        return yaml_tree(path.read_text(encoding="utf-8-sig"), path)  # editors may write a byte order mark
    except OSError as error:
        raise CalibrationError(f"{path}: can't be read ({error.strerror})") from None
    except ValueError as error:
        raise CalibrationError(f"{path}: not valid YAML: {error}") from None


def yaml_tree(text: str, path: Path) -> Tree:
    """Return the content of a YAML file, also with OpenCV's header.

    Args:
        text: of the file.
        path: named in errors.

    Raises:
        CalibrationError: it holds no keys and values.
    """
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):  # OpenCV's "%YAML:1.0" is not valid YAML
        lines[0] = ""
    try:
        tree = parse_yaml("\n".join(lines), _Loader)
    except InvalidYaml as error:
        raise CalibrationError(f"{path}: not valid YAML: {error}") from None
    if not isinstance(tree, dict):
        raise CalibrationError(f"{path}: holds no keys and values; give a calibration file")
    return tree
