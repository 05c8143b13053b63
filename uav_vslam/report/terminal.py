# SPDX-License-Identifier: Apache-2.0
"""The terminal, or the pipe, that tables are printed to."""

from rich.console import Console


class Terminal(Console):
    """Tells a reader that has gone away as `print` does; rich itself exits with the code of a failure."""

    def on_broken_pipe(self) -> None:
        """Raise what the pipe did."""
        raise BrokenPipeError
