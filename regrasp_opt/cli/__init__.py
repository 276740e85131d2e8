"""The command `regrasp-opt`.

Exit codes: 0 solved or ok, 1 no plan or a check failed, 2 bad input, 130 interrupted, 143 ended by SIGTERM.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; errors end in one line on stderr."""
    from regrasp_opt.cli import interrupts

    try:
        interrupts.install()
        from regrasp_opt.cli.app import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = interrupts.conclude()
    if interrupts.received():
        interrupts.leave(code)
    interrupts.let_go()
    sys.exit(code)
