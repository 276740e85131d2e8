"""What could break the planner, tried on purpose: plans in adversity, damaged input, killed commands.

``python -m tests.fuzz.reliability``, from the repository, runs the campaign and writes the page `docs/reliability.md`.
"""

import sys
from pathlib import Path

TESTS = str(Path(__file__).parents[1])
if TESTS not in sys.path:
    sys.path.append(TESTS)  # where pytest finds this package and the verifiers of `oracles`
