"""Can strangers ask my lake without harm? Run their SQL in the sandbox, and see what is refused.

Run it as ``python examples/can_strangers_ask_my_lake.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import breplake
from breplake.errors import LimitError, UsageError

QUESTIONS = (
    "SELECT type, count(*) AS patches FROM patches GROUP BY type ORDER BY patches DESC LIMIT 3",
    "WITH x AS (COPY (SELECT 1) TO 'stolen.csv') SELECT * FROM x",
    "SELECT * FROM read_text('/etc/hostname')",
    "SELECT count(*) FROM vertices a, vertices b, vertices c WHERE a.x < b.y + c.z",
)


def main(path: Path) -> None:
    sandbox = breplake.open(path).sandbox(timeout=5, memory=0.5, max_rows=100)
    for question in QUESTIONS:
        print(question)
        try:
            print("    answered:", sandbox.sql(question).to_pylist())
        except UsageError as error:
            print("    refused:", str(error).splitlines()[0])
        except LimitError as error:
            print("    stopped:", error)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
