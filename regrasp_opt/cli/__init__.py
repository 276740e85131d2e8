"""The `regrasp-opt` command. Exit codes: 0 solved or ok, 1 no plan or a check failed, 2 bad input, 130 interrupted."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; errors end in one line on stderr."""
    from regrasp_opt.cli.app import run

    sys.exit(run(sys.argv[1:]))
