# SPDX-License-Identifier: Apache-2.0
"""YAML to values; whatever is wrong with it is one error that says where.

PyYAML itself lets other errors pass where a value is not what it looks like: 2024-13-45 is no date, 0x_ no number.
"""

from typing import Any

import yaml

from uav_vslam.errors import InvalidYaml, one_line


class Loader(yaml.SafeLoader):
    """Names the line of such a value as of any other fault; what contains itself is refused."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Return the value of a node."""
        try:
            return super().construct_object(node, deep=True)
        except (AttributeError, LookupError, ValueError) as error:
            problem = f"{node.value!r} is no {node.tag.rpartition(':')[2]} ({one_line(error)})"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None


def parse_yaml(text: str, loader: type[Loader] = Loader) -> Any:
    """Return the content of a text.

    Args:
        text: YAML.
        loader: makes the values.

    Raises:
        InvalidYaml: it is none.
    """
    try:
        return yaml.load(text, loader)
    except yaml.MarkedYAMLError as error:
        where = f" (line {error.problem_mark.line + 1})" if error.problem_mark else ""
        raise InvalidYaml(f"{error.problem}{where}") from None
    except yaml.YAMLError as error:
        raise InvalidYaml(one_line(error)) from None
    except RecursionError:
        raise InvalidYaml("nested too deeply") from None
