# SPDX-License-Identifier: Apache-2.0
"""Entry point of the installed `uav-vslam`: Ctrl-C while the command itself is imported ends it as one later does."""

INTERRUPTED = 130


def main() -> int:
    """Import and run the command, and return its exit code."""
    try:
        from uav_vslam.cli.main import main as command

        return command()
    except KeyboardInterrupt:
        return INTERRUPTED
