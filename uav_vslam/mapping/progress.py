# SPDX-License-Identifier: Apache-2.0
"""Progress through views and images that are read one by one."""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def counted(items: Iterable[Item], on_item: Callable[[], object]) -> Iterator[Item]:
    """Yield items, and call a function when each has been used."""
    for item in items:
        yield item
        on_item()
