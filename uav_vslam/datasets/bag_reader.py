# SPDX-License-Identifier: Apache-2.0
"""rosbags' reader, with which a process parses each text of a bag's metadata once, and which is more lenient with mcap.

Whoever looks at a recording opens its bags several times, and nearly all that an opening takes, some 40 ms for two
vehicles, is the YAML of the metadata and of each connection's QoS.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from rosbags.rosbag2 import metadata, reader
from rosbags.rosbag2.reader import YAML, DirectoryReader

from uav_vslam.datasets.mcap_file import McapFile

__all__ = ["Folder", "Reader"]

TEXTS = 256  # remembered at most: each topic may have a QoS of its own


class Folder(DirectoryReader):
    """A bag's folder with its metadata."""

    STORAGE_PLUGINS: Mapping[str, Any] = {**DirectoryReader.STORAGE_PLUGINS, "mcap": McapFile}


class Reader(reader.Reader):
    """Reads a folder or a storage file."""

    STORAGE_PLUGINS: Mapping[str, Any] = {**reader.Reader.STORAGE_PLUGINS, "dir": Folder, ".mcap": McapFile}

    @property
    def storages(self) -> list[Any]:
        """Readers of the storage files, while it is open."""
        return self.storage.storages if isinstance(self.storage, Folder) else [self.storage]

    @property
    def mcap_files(self) -> list[McapFile]:
        """Those of mcap files."""
        return [one for one in self.storages if isinstance(one, McapFile)]


class _Parser(YAML):
    """Remembers what texts hold, which the readers leave as it is."""

    def load(self, stream: Any) -> Any:
        return _parsed(stream) if isinstance(stream, str) else super().load(stream)


@lru_cache(maxsize=TEXTS)
def _parsed(text: str) -> Any:
    return YAML(typ="safe").load(text)


for _module in (reader, metadata):  # both make a parser for each text
    setattr(_module, "YAML", _Parser)  # noqa: B010 (mypy takes the name for a type)
