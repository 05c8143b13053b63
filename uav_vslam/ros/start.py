# SPDX-License-Identifier: Apache-2.0
"""Entry point of all node programs: `slam_backend`, as installed in lib/uav_vslam, is the node slam_backend.

The nodes' libraries take a second to import. Nothing is open before, so Ctrl-C ends the program at once, without a
traceback; from then on `runtime.run_node` handles signals.

What they make lives as long as the process. The garbage collector leaves it alone: it finds nothing there while they
are imported, in flight or, longest of all, when the interpreter ends.
"""

import gc
import signal
import sys
from importlib import import_module
from pathlib import Path


def main() -> int:
    """Run the node that the program is named after and return its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    name = Path(sys.argv[0]).name
    gc.disable()
    node = import_module(f"uav_vslam.ros.{name}_node")
    gc.freeze()
    gc.enable()
    return int(node.main())
