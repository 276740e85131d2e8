"""``python -m tests.oracles FILE ...``: verify saved plans and motions; exit with 1 if a claim does not hold."""

import json
import sys
from pathlib import Path

from .motions import verify_motion
from .plans import verify_plan


def main(paths):
    wrong = 0
    for path in paths:
        kind = json.loads(Path(path).read_text("utf-8")).get("kind", "plan")
        problems = verify_motion(path) if kind == "motion" else verify_plan(path)
        print(f"{path}: {'verified' if not problems else ''}", *problems, sep="\n  " if problems else "")
        wrong += bool(problems)
    return 1 if wrong else 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python -m tests.oracles PLAN_OR_MOTION.json ...")
    sys.exit(main(sys.argv[1:]))
